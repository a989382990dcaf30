"""Trains network ``plus``: ``python -m planner.policy.train``; with ``torchrun`` on several processes.

Teacher forcing with cross-entropy (equation 12) over single decisions: the state before each decision of the expert is
simulated, so a plan of T decisions is T samples. AdamW, linear warm-up, cosine decay. Every plan is turned and mirrored
at random each time it is seen, and UAVs that are alike take their turns in random order. A checkpoint is written whole
or not at all after every epoch, and a run goes on from it: same seed, same order of the data.
"""

from __future__ import annotations

import argparse
import math
import os
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import rich.progress
import torch
from torch import distributed
from torch.nn.parallel import DistributedDataParallel

from planner.errors import PlannerError, exit_on_error
from planner.instances import DATA_SETS, data_set
from planner.labels import FOLDER
from planner.policy.batches import Pool, batches, pool, steps_of
from planner.policy.config import PlusConfig
from planner.policy.domain import Domain
from planner.policy.examples import Example, Source, gather, load, save
from planner.policy.plus_net import Batch, PlusNet
from planner.policy.training import COLUMNS, Progress, Training
from planner.policy.weights import read

HELP = {
    "epochs": "passes through the data",
    "batch": "decisions per step",
    "parts": "a batch is gone through in so many parts of graphs of about one size",
    "seed": "of weights, order and symmetries",
    "rate": "highest learning rate",
    "smooth": "label smoothing",
    "decay": "weight decay",
    "dim": "width of the network",
    "heads": "attention heads",
    "layers": "layers",
    "hidden": "width inside a layer's feed-forward part",
}
SEEN = 2_000  # plans from which it is told what a network has seen


def to_tensors(pool: Pool, device: torch.device) -> tuple[Batch, torch.Tensor]:
    """A batch on the device, and the experts' choices, (B, U), -1 behind the last."""
    parts = (pool.task, pool.site, pool.uav, pool.ugv, pool.pair, pool.drive, pool.counts)
    batch = Batch(*(torch.from_numpy(np.ascontiguousarray(x)).to(device) for x in parts))
    return batch, torch.from_numpy(pool.option.astype(np.int64)).to(device)


def loss_of(logits: torch.Tensor, option: torch.Tensor, smooth: float = 0.0) -> torch.Tensor:
    """Cross-entropy, equation (12), the mean over decisions.

    Where UAVs are alike it does not matter which of them takes which of their next actions: all count as right.

    Args:
        logits: (B, options).
        option: the right ones, (B, U), -1 behind the last.
        smooth: share of the target that is spread over what is offered.
    """
    log_p = logits.log_softmax(-1)
    right = log_p.gather(1, option.clamp(min=0)).masked_fill(option < 0, -math.inf)
    loss = -right.logsumexp(-1).mean()
    if smooth > 0.0:
        offered = logits > -1e8
        mean = log_p.masked_fill(~offered, 0.0).sum(-1) / offered.sum(-1).clamp(min=1)
        loss = (1.0 - smooth) * loss - smooth * mean.mean()
    return loss


def hits(logits: torch.Tensor, option: torch.Tensor) -> int:
    """Decisions where one of the right choices has the largest logit."""
    return int((logits.argmax(-1, keepdim=True) == option).any(-1).sum())


def _ahead(source: Iterator[list[Pool]]) -> Iterator[list[Pool]]:
    """The same batches, the next one made in another thread meanwhile."""
    with ThreadPoolExecutor(1) as pool:
        coming = pool.submit(next, source, None)
        while (some := coming.result()) is not None:
            coming = pool.submit(next, source, None)
            yield some


def measure(net: torch.nn.Module, examples: Sequence[Example], batch: int, device: torch.device) -> tuple[float, float]:
    """Mean loss per decision, and the share of decisions where the expert's choice has the largest logit."""
    net.eval()
    total, right, n = 0.0, 0, 0
    with torch.inference_mode():
        for some in batches(examples, batch, np.random.default_rng(0), augment=False, parts=Training().parts):
            for one in some:
                inputs, option = to_tensors(one, device)
                logits = net(inputs)
                total += float(loss_of(logits, option)) * len(option)
                right += hits(logits, option)
                n += len(option)
    return total / max(1, n), right / max(1, n)


class Trainer:
    """One training run of network ``plus``."""

    def __init__(
        self,
        folder: Path,
        config: PlusConfig,
        how: Training,
        device: torch.device | None = None,
        start: Path | None = None,
    ) -> None:
        """Goes on from ``folder``'s checkpoint where there is one, else from the weights in ``start`` or anew.

        Raises:
            PlannerError: where that is of another network, or cannot be read.
        """
        self.how = how
        self.rank = distributed.get_rank() if distributed.is_initialized() else 0
        self.world = distributed.get_world_size() if distributed.is_initialized() else 1
        self.device = device or torch.device("cuda" if torch.cuda.is_available() else "cpu")
        torch.manual_seed(how.seed)
        self.net = PlusNet(config).to(self.device)
        if start is not None:
            of, tensors, _ = read(start)
            if of != config:
                raise PlannerError(f"{start}: these weights are of another network; give the same dim, heads, layers")
            try:
                self.net.load_state_dict({name: torch.from_numpy(x) for name, x in tensors.items()})
            except RuntimeError as error:
                raise PlannerError(f"{start}: these weights are incomplete: {error}") from error
        adam = torch.optim.AdamW(self.net.parameters(), lr=how.rate, weight_decay=how.decay, betas=(0.9, 0.98))
        self.at = Progress(folder, config, how, self.net, adam)

    def _passes(self, examples: Sequence[Example], rng: np.random.Generator) -> Iterator[list[Pool]]:
        """One pass through the data, or passes without end where processes have to keep step."""
        how = self.how
        yield from batches(examples, how.batch, rng, augment=how.augment, parts=how.parts)
        while self.world > 1:
            yield from batches(examples, how.batch, rng, augment=how.augment, parts=how.parts)

    def _has_time(self) -> bool:
        """Whether another epoch may begin; by the first process's clock, or some would wait for others for ever."""
        seconds = torch.tensor(self.at.seconds, device=self.device)
        if self.world > 1:
            distributed.broadcast(seconds, 0)
        return float(seconds) < self.how.time_s

    def _no_sync(self, last: bool, net: torch.nn.Module) -> AbstractContextManager[None]:
        """Processes add their gradients up with the last part of a batch only."""
        return nullcontext() if last or not isinstance(net, DistributedDataParallel) else net.no_sync()

    def run(self, train: Sequence[Example], valid: Sequence[Example], *, quiet: bool = False) -> list[dict[str, float]]:
        """Trains to the last epoch or until the time is up; the rows of the curve that were added.

        Raises:
            PlannerError: where there is nothing to train on.
        """
        how = self.how
        if len(train) < self.world:
            raise PlannerError("training: there are no examples; make labels first (python -m planner.labels)")
        mine = list(train)[self.rank :: self.world]
        net: torch.nn.Module = self.net
        if self.world > 1:
            net = DistributedDataParallel(self.net)
        per_epoch = steps_of(mine, how.batch)
        if self.world > 1:
            fewest = torch.tensor(per_epoch, device=self.device)
            distributed.all_reduce(fewest, distributed.ReduceOp.MIN)
            per_epoch = int(fewest)
        domain = Domain.of(pool([e], [0]) for e in mine[:: max(1, len(mine) // SEEN)])
        at, steps, rows = self.at, how.epochs * per_epoch, []
        with rich.progress.Progress(disable=quiet or self.rank > 0) as bar:
            task = bar.add_task("training", total=steps, completed=at.step)
            while at.epoch < how.epochs and self._has_time():
                begun = time.perf_counter()
                net.train()
                rng = np.random.default_rng([how.seed, at.epoch, self.rank])
                total, right, n, taken = 0.0, 0, 0, 0
                for some in _ahead(self._passes(mine, rng)):
                    if self.world > 1 and taken >= per_epoch:
                        break  # every process takes as many steps as the others, or they wait for ever
                    rate = at.rate(steps)
                    at.adam.zero_grad(set_to_none=True)
                    decisions = sum(len(one.option) for one in some)
                    for k, one in enumerate(some):
                        inputs, option = to_tensors(one, self.device)
                        with self._no_sync(k + 1 == len(some), net):
                            with torch.autocast(self.device.type, torch.bfloat16, how.bfloat16):
                                logits = net(inputs)
                            loss = loss_of(logits.float(), option, how.smooth) * (len(option) / decisions)
                            loss.backward()  # type: ignore[no-untyped-call]
                        total += float(loss.detach()) * decisions
                        right += hits(logits.detach(), option)
                    n += decisions
                    torch.nn.utils.clip_grad_norm_(net.parameters(), how.clip)
                    at.adam.step()
                    at.step, taken = at.step + 1, taken + 1
                    bar.update(task, completed=at.step, description=f"loss {total / n:.3f}")
                at.epoch += 1
                at.seconds += time.perf_counter() - begun
                loss_v, right_v = measure(self.net, valid, how.batch, self.device) if valid else (math.nan, math.nan)
                values = (at.epoch, at.step, round(at.seconds, 1), rate, total / n, right / n, loss_v, right_v)
                rows.append(dict(zip(COLUMNS, values, strict=True)))
                if self.rank == 0:
                    at.save(rows[-1], loss_v if valid else total / n, {"domain": domain.to_json()})
        return rows


def prepare(cache: Path, sources: Sequence[Source]) -> list[Example]:
    """Examples of all sources, each from a cache file that is made where it is missing.

    Raises:
        PlannerError: where a data set has no labels at all, and as ``planner.labels.read`` and ``examples.load``.
    """
    found: list[Example] = []
    for one in sources:
        files = sorted((one.folder / one.name).glob("*.npz"))
        if not files:
            folder, make = one.folder / one.name, f"python -m planner.labels --sets {one.name}"
            raise PlannerError(f"{folder}: there are no labels; make them first: {make} --out {one.folder}")
        stamp = f"{len(files)}-{sum(f.stat().st_size for f in files)}"
        path = cache / f"{one.name}_{one.first}_{one.count}_{one.midway}_{one.steps}_{one.seed}_{stamp}.npz"
        if not path.exists():
            save(path, gather(one), {"data_set": one.name, "first": one.first, "midway": one.midway})
        found += load(path)
    return found


def main(arguments: Sequence[str] | None = None, prog: str = "python -m planner.policy.train") -> None:
    """The command line.

    Raises:
        PlannerError: a data set does not exist, there are no labels, or a checkpoint is another network's.
    """
    how = Training()
    every = ",".join(one.name for one in DATA_SETS)
    parser = argparse.ArgumentParser(prog=prog, description="Trains network plus from the expert's labels; resumable.")
    parser.add_argument("--labels", type=Path, default=FOLDER, help="folder of labels (python -m planner.labels)")
    parser.add_argument("--sets", default=every, help="data sets, with commas between; default: the paper's eight")
    parser.add_argument("--out", type=Path, default=Path("runs/policy"), help="checkpoint, curve, weights")
    parser.add_argument("--weights", type=Path, help="to begin with, instead of random ones")
    parser.add_argument("--cache", type=Path, default=Path("runs/policy_cache"), help="examples made from labels")
    parser.add_argument("--count", type=int, default=800, help="instances of each data set to train on")
    parser.add_argument("--valid", type=int, default=50, help="instances after these, to watch the loss on")
    parser.add_argument("--midway", type=int, default=0, help="mid-mission states per instance")
    parser.add_argument("--more", type=Path, nargs="*", default=[], help="files of examples made otherwise")
    for name in ("epochs", "batch", "parts", "seed"):
        parser.add_argument(f"--{name}", type=int, default=getattr(how, name), help=HELP[name])
    for name in ("rate", "smooth", "decay"):
        parser.add_argument(f"--{name}", type=float, default=getattr(how, name), help=HELP[name])
    parser.add_argument("--time", type=float, default=math.inf, help="no epoch is begun after so many s, in all runs")
    parser.add_argument("--no-augment", action="store_true", help="plans are not turned and mirrored")
    parser.add_argument("--bfloat16", action="store_true", help="faster, where the processor has it")
    parser.add_argument("--no-uav-edges", action="store_true", help="UAVs are connected to nothing")
    parser.add_argument("--no-ugv-edges", action="store_true", help="UGVs are connected to nothing")
    for name in ("dim", "heads", "layers", "hidden"):
        parser.add_argument(f"--{name}", type=int, default=getattr(PlusConfig(), name), help=HELP[name])
    given = parser.parse_args(arguments)
    device = None
    if "RANK" in os.environ:
        gpu = torch.cuda.is_available()
        distributed.init_process_group("nccl" if gpu else "gloo", timeout=timedelta(hours=4))
        if gpu:
            device = torch.device("cuda", int(os.environ["LOCAL_RANK"]))
            torch.cuda.set_device(device)
    config = PlusConfig(
        given.dim, given.heads, given.layers, given.hidden, not given.no_uav_edges, not given.no_ugv_edges
    )
    how = replace(
        how, epochs=given.epochs, batch=given.batch, seed=given.seed, rate=given.rate, smooth=given.smooth,
        decay=given.decay, time_s=given.time, augment=not given.no_augment, parts=given.parts, bfloat16=given.bfloat16,
    )  # fmt: skip
    names = [data_set(name.strip()).name for name in given.sets.split(",")]
    if distributed.is_initialized() and distributed.get_rank() > 0:
        distributed.barrier()  # the first process makes the cache
    train = prepare(given.cache, [Source(given.labels, x, 0, given.count, given.midway, how.seed) for x in names])
    valid = prepare(given.cache, [Source(given.labels, x, given.count, given.valid) for x in names])
    for path in given.more:
        train += load(path)
    if distributed.is_initialized() and distributed.get_rank() == 0:
        distributed.barrier()
    trainer = Trainer(given.out, config, how, device, given.weights)
    if trainer.at.epoch >= how.epochs:
        print(f"{given.out}: all {how.epochs} epochs are done; give more --epochs, or another --out")
    trainer.run(train, valid)
    if trainer.rank == 0:
        told = f"{len(train)} plans, {trainer.at.epoch} epochs, {trainer.at.seconds:.0f} s"
        if valid:
            loss, right = measure(trainer.net, valid, how.batch, trainer.device)
            told += f"; on others: loss {loss:.4f}, right {right:.1%}"
        print(told)
    if distributed.is_initialized():
        distributed.destroy_process_group()


if __name__ == "__main__":
    exit_on_error(main)
