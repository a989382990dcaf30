"""Trains network ``plus``: ``python -m planner.policy.train``; with ``torchrun`` on several processes.

Teacher forcing with cross-entropy (equation 12) over single decisions: the state before each decision of the expert is
simulated, so a plan of T decisions is T samples. AdamW, linear warm-up, cosine decay. Every plan is turned and mirrored
at random each time it is seen; vehicles have no names, so there is nothing to permute. A checkpoint is written whole or
not at all after every epoch, and a run goes on from it: same seed, same order of the data.
"""

from __future__ import annotations

import argparse
import csv
import math
import os
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.progress import Progress
from torch import distributed
from torch.nn import functional as fn
from torch.nn.parallel import DistributedDataParallel

from planner.errors import PlannerError
from planner.policy.batches import Pool, batches, steps_of
from planner.policy.config import PlusConfig
from planner.policy.examples import Example, Source, gather, load, save
from planner.policy.plus_net import Batch, PlusNet
from planner.policy.weights import write

FORMAT = "copcs-checkpoint/1"
COLUMNS = ("epoch", "steps", "seconds", "rate", "train_loss", "train_right", "valid_loss", "valid_right")


@dataclass(frozen=True, slots=True)
class Training:
    """How to train.

    Attributes:
        epochs: passes through the data.
        batch: decisions per step and process.
        rate: the highest learning rate.
        warm_up: share of all steps in which the rate rises.
        last: the last rate as a share of the highest.
        decay: weight decay.
        clip: norm to which gradients are cut.
        smooth: label smoothing over what is offered.
        augment: whether plans are turned and mirrored.
        seed: of weights, order and symmetries.
        time_s: no epoch is begun after that, in all runs together.
    """

    epochs: int = 40
    batch: int = 512
    rate: float = 1e-3
    warm_up: float = 0.05
    last: float = 0.02
    decay: float = 0.01
    clip: float = 1.0
    smooth: float = 0.0
    augment: bool = True
    seed: int = 0
    time_s: float = math.inf

    def __post_init__(self) -> None:
        for name in ("epochs", "batch", "rate", "clip", "time_s"):
            if not getattr(self, name) > 0:
                raise PlannerError(f"training: {name} is {getattr(self, name)!r}; give a number above 0")


def schedule(step: int, steps: int, how: Training) -> float:
    """Learning rate at ``step`` of ``steps``: linear up, then half a cosine down."""
    up = max(1, round(how.warm_up * steps))
    if step < up:
        return how.rate * (step + 1) / up
    share = min(1.0, (step - up) / max(1, steps - up))
    return how.rate * (how.last + (1.0 - how.last) * 0.5 * (1.0 + math.cos(math.pi * share)))


def to_tensors(pool: Pool, device: torch.device) -> tuple[Batch, torch.Tensor]:
    """A batch on the device, and the experts' choices, (B,)."""
    parts = (pool.task, pool.site, pool.uav, pool.ugv, pool.pair, pool.drive, pool.counts)
    batch = Batch(*(torch.from_numpy(np.ascontiguousarray(x)).to(device) for x in parts))
    return batch, torch.from_numpy(pool.option.astype(np.int64)).to(device)


def loss_of(logits: torch.Tensor, option: torch.Tensor, smooth: float = 0.0) -> torch.Tensor:
    """Cross-entropy, equation (12), the mean over decisions; ``smooth`` is spread over what is offered."""
    log_p = logits.log_softmax(-1)
    loss = fn.nll_loss(log_p, option)
    if smooth > 0.0:
        offered = logits > -1e8
        mean = log_p.masked_fill(~offered, 0.0).sum(-1) / offered.sum(-1).clamp(min=1)
        loss = (1.0 - smooth) * loss - smooth * mean.mean()
    return loss


def _ahead(source: Iterator[Pool]) -> Iterator[Pool]:
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
        for pool in batches(examples, batch, np.random.default_rng(0), augment=False):
            inputs, option = to_tensors(pool, device)
            logits = net(inputs)
            total += float(loss_of(logits, option)) * len(option)
            right += int((logits.argmax(-1) == option).sum())
            n += len(option)
    return total / max(1, n), right / max(1, n)


class Trainer:
    """Network, optimiser and progress of one training run; ``folder`` holds checkpoint, curve and weights."""

    def __init__(self, folder: Path, config: PlusConfig, how: Training, device: torch.device | None = None) -> None:
        """Goes on from ``folder``'s checkpoint where there is one.

        Raises:
            PlannerError: where that is of another network, or cannot be read.
        """
        self.folder, self.config, self.how = folder, config, how
        self.rank = distributed.get_rank() if distributed.is_initialized() else 0
        self.world = distributed.get_world_size() if distributed.is_initialized() else 1
        self.device = device or torch.device("cuda" if torch.cuda.is_available() else "cpu")
        torch.manual_seed(how.seed)
        self.net = PlusNet(config).to(self.device)
        self.adam = torch.optim.AdamW(self.net.parameters(), lr=how.rate, weight_decay=how.decay, betas=(0.9, 0.98))
        self.epoch, self.step, self.seconds = 0, 0, 0.0
        self.best = math.inf
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / "checkpoint.pt").exists():
            self._resume()

    def _resume(self) -> None:
        path = self.folder / "checkpoint.pt"
        try:
            data = torch.load(path, map_location=self.device, weights_only=True)
        except Exception as error:
            raise PlannerError(f"{path}: the checkpoint cannot be read: {error}; remove it to start anew") from error
        if data.get("format") != FORMAT or data["config"] != self.config.to_json():
            raise PlannerError(f"{path}: the checkpoint is of another network; give another folder, or remove it")
        self.net.load_state_dict(data["net"])
        self.adam.load_state_dict(data["adam"])
        self.epoch, self.step, self.seconds, self.best = data["epoch"], data["step"], data["seconds"], data["best"]

    def save(self, row: dict[str, float], valid: float) -> None:
        """Writes checkpoint, curve and weights; only the first process does."""
        if self.rank:
            return
        part = self.folder / "checkpoint.part"
        torch.save(
            {
                "format": FORMAT,
                "config": self.config.to_json(),
                "net": self.net.state_dict(),
                "adam": self.adam.state_dict(),
                "epoch": self.epoch,
                "step": self.step,
                "seconds": self.seconds,
                "best": min(self.best, valid),
            },
            part,
        )
        part.replace(self.folder / "checkpoint.pt")
        curve = self.folder / "curve.csv"
        new = not curve.exists()
        with curve.open("a", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS)
            if new:
                writer.writeheader()
            writer.writerow(row)
        about = {"training": _plain(self.how), **row}
        write(self.folder / "last.safetensors", self.config, self.tensors(), about)
        if valid <= self.best:
            write(self.folder / "best.safetensors", self.config, self.tensors(), about)
        self.best = min(self.best, valid)

    def tensors(self) -> dict[str, Any]:
        """The weights as arrays."""
        return {k: v.detach().cpu().numpy() for k, v in self.net.state_dict().items()}

    def _passes(self, examples: Sequence[Example], rng: np.random.Generator) -> Iterator[Pool]:
        """One pass through the data, or passes without end where processes have to keep step."""
        yield from batches(examples, self.how.batch, rng, augment=self.how.augment)
        while self.world > 1:
            yield from batches(examples, self.how.batch, rng, augment=self.how.augment)

    def run(self, train: Sequence[Example], valid: Sequence[Example], *, quiet: bool = False) -> list[dict[str, float]]:
        """Trains to the last epoch or until the time is up; the rows of the curve that were added.

        Raises:
            PlannerError: where there is nothing to train on.
        """
        how = self.how
        mine = list(train)[self.rank :: self.world]
        if not mine:
            raise PlannerError("training: there are no examples; make labels first (python -m planner.labels)")
        net: torch.nn.Module = self.net
        if self.world > 1:
            net = DistributedDataParallel(self.net)
        per_epoch = steps_of(mine, how.batch)
        if self.world > 1:
            fewest = torch.tensor(per_epoch, device=self.device)
            distributed.all_reduce(fewest, distributed.ReduceOp.MIN)
            per_epoch = int(fewest)
        rows = []
        with Progress(disable=quiet or self.rank > 0) as bar:
            task = bar.add_task("training", total=how.epochs * per_epoch, completed=self.step)
            while self.epoch < how.epochs and self.seconds < how.time_s:
                begun = time.perf_counter()
                net.train()
                rng = np.random.default_rng([how.seed, self.epoch, self.rank])
                total, right, n, taken = 0.0, 0, 0, 0
                for pool in _ahead(self._passes(mine, rng)):
                    if self.world > 1 and taken >= per_epoch:
                        break  # every process takes as many steps as the others, or they wait for ever
                    rate = schedule(self.step, how.epochs * per_epoch, how)
                    for group in self.adam.param_groups:
                        group["lr"] = rate
                    inputs, option = to_tensors(pool, self.device)
                    logits = net(inputs)
                    loss = loss_of(logits, option, how.smooth)
                    self.adam.zero_grad(set_to_none=True)
                    loss.backward()  # type: ignore[no-untyped-call]
                    torch.nn.utils.clip_grad_norm_(net.parameters(), how.clip)
                    self.adam.step()
                    total += float(loss.detach()) * len(option)
                    right += int((logits.detach().argmax(-1) == option).sum())
                    n += len(option)
                    self.step, taken = self.step + 1, taken + 1
                    bar.update(task, completed=self.step, description=f"loss {total / n:.3f}")
                self.epoch += 1
                self.seconds += time.perf_counter() - begun
                loss_v, right_v = measure(self.net, valid, how.batch, self.device) if valid else (math.nan, math.nan)
                row = {
                    "epoch": self.epoch,
                    "steps": self.step,
                    "seconds": round(self.seconds, 1),
                    "rate": rate,
                    "train_loss": total / n,
                    "train_right": right / n,
                    "valid_loss": loss_v,
                    "valid_right": right_v,
                }
                self.save(row, loss_v if valid else total / n)
                rows.append(row)
        return rows


def _plain(how: Training) -> dict[str, Any]:
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in asdict(how).items()}


def prepare(cache: Path, sources: Sequence[Source]) -> list[Example]:
    """Examples of all sources, each from a cache file that is made where it is missing.

    Raises:
        PlannerError: as ``planner.labels.read`` and ``examples.load``.
    """
    found: list[Example] = []
    for one in sources:
        files = sorted((one.folder / one.name).glob("*.npz"))
        stamp = f"{len(files)}-{sum(f.stat().st_size for f in files)}"
        path = cache / f"{one.name}_{one.first}_{one.count}_{one.midway}_{one.steps}_{one.seed}_{stamp}.npz"
        if not path.exists():
            save(path, gather(one), {"data_set": one.name, "first": one.first, "midway": one.midway})
        found += load(path)
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """The command line."""
    how = Training()
    parser = argparse.ArgumentParser(
        prog="python -m planner.policy.train", description="Trains network plus; resumable."
    )
    parser.add_argument("--labels", type=Path, default=Path("benchmarks/labels"))
    parser.add_argument("--sets", required=True, help="data sets, with commas between")
    parser.add_argument("--out", type=Path, default=Path("runs/policy"), help="checkpoint, curve, weights")
    parser.add_argument("--cache", type=Path, default=Path("runs/policy_cache"))
    parser.add_argument("--count", type=int, default=800, help="instances of each data set to train on")
    parser.add_argument("--valid", type=int, default=50, help="instances after these, to watch the loss on")
    parser.add_argument("--midway", type=int, default=0, help="mid-mission states per instance")
    parser.add_argument("--more", type=Path, nargs="*", default=[], help="files of examples made otherwise")
    for name in ("epochs", "batch", "seed"):
        parser.add_argument(f"--{name}", type=int, default=getattr(how, name))
    for name in ("rate", "smooth", "decay"):
        parser.add_argument(f"--{name}", type=float, default=getattr(how, name))
    parser.add_argument("--time", type=float, default=math.inf, help="in s")
    parser.add_argument("--no-augment", action="store_true")
    parser.add_argument("--no-uav-edges", action="store_true")
    parser.add_argument("--no-ugv-edges", action="store_true")
    for name in ("dim", "heads", "layers", "hidden"):
        parser.add_argument(f"--{name}", type=int, default=getattr(PlusConfig(), name))
    given = parser.parse_args(arguments)
    device = None
    if "RANK" in os.environ:
        gpu = torch.cuda.is_available()
        distributed.init_process_group("nccl" if gpu else "gloo")
        if gpu:
            device = torch.device("cuda", int(os.environ["LOCAL_RANK"]))
            torch.cuda.set_device(device)
    config = PlusConfig(
        given.dim, given.heads, given.layers, given.hidden, not given.no_uav_edges, not given.no_ugv_edges
    )
    how = replace(
        how, epochs=given.epochs, batch=given.batch, seed=given.seed, rate=given.rate, smooth=given.smooth,
        decay=given.decay, time_s=given.time, augment=not given.no_augment,
    )  # fmt: skip
    names = [name.strip() for name in given.sets.split(",")]
    train = prepare(given.cache, [Source(given.labels, x, 0, given.count, given.midway, how.seed) for x in names])
    valid = prepare(given.cache, [Source(given.labels, x, given.count, given.valid) for x in names])
    for path in given.more:
        train += load(path)
    trainer = Trainer(given.out, config, how, device)
    trainer.run(train, valid)
    if trainer.rank == 0:
        loss, right = measure(trainer.net, valid, how.batch, trainer.device) if valid else (math.nan, math.nan)
        print(
            f"{len(train)} plans, {trainer.epoch} epochs, {trainer.seconds:.0f} s: loss {loss:.4f}, right {right:.1%}"
        )


if __name__ == "__main__":
    main()
