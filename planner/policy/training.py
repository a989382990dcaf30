"""What training runs of all networks have in common: settings, learning rate, checkpoints, curve, weights."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch

from planner.errors import PlannerError
from planner.policy.config import PaperConfig, PlusConfig
from planner.policy.weights import write

FORMAT = "copcs-checkpoint/1"
COLUMNS = ("epoch", "steps", "seconds", "rate", "train_loss", "train_right", "valid_loss", "valid_right")


@dataclass(frozen=True, slots=True)
class Training:
    """How to train.

    Attributes:
        epochs: passes through the data.
        batch: decisions (``paper``: plans) per step and process.
        rate: the highest learning rate.
        warm_up: share of all steps in which the rate rises.
        last: the last rate as a share of the highest.
        decay: weight decay.
        clip: norm to which gradients are cut.
        smooth: label smoothing over what is offered.
        augment: whether plans are turned and mirrored.
        parts: each batch is gone through in so many parts of graphs of about one size, which spares padding.
        bfloat16: whether products of matrices are computed in that format; twice as fast where the processor has it.
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
    parts: int = 4
    bfloat16: bool = False
    seed: int = 0
    time_s: float = math.inf

    def __post_init__(self) -> None:
        for name in ("epochs", "batch", "rate", "clip", "parts", "time_s"):
            if not getattr(self, name) > 0:
                raise PlannerError(f"training: {name} is {getattr(self, name)!r}; give a number above 0")
        for name in ("decay", "seed"):
            if not getattr(self, name) >= 0:
                raise PlannerError(f"training: {name} is {getattr(self, name)!r}; give a number of at least 0")
        if not 0.0 <= self.smooth < 1.0:
            raise PlannerError(f"training: smooth is {self.smooth!r}; give a number from 0 to below 1")
        if self.batch < self.parts:
            raise PlannerError(f"training: a batch of {self.batch} cannot come in {self.parts} parts; give fewer parts")

    def to_json(self) -> dict[str, Any]:
        """A JSON object; null is infinite."""
        return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in asdict(self).items()}


def schedule(step: int, steps: int, how: Training) -> float:
    """Learning rate at ``step`` of ``steps``: linear up, then half a cosine down."""
    up = max(1, round(how.warm_up * steps))
    if step < up:
        return how.rate * (step + 1) / up
    share = min(1.0, (step - up) / max(1, steps - up))
    return how.rate * (how.last + (1.0 - how.last) * 0.5 * (1.0 + math.cos(math.pi * share)))


class Progress:
    """Network, optimiser and how far a run is; ``folder`` holds checkpoint, curve and weights."""

    def __init__(
        self,
        folder: Path,
        config: PlusConfig | PaperConfig,
        how: Training,
        net: torch.nn.Module,
        adam: torch.optim.Optimizer,
    ) -> None:
        """Goes on from ``folder``'s checkpoint where there is one.

        Raises:
            PlannerError: where that is of another network, or cannot be read.
        """
        self.folder, self.config, self.how, self.net, self.adam = folder, config, how, net, adam
        self.epoch, self.step, self.seconds, self.best = 0, 0, 0.0, math.inf
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / "checkpoint.pt"
        if not path.exists():
            return
        try:
            data = torch.load(path, map_location=next(net.parameters()).device, weights_only=True)
            if data.get("format") != FORMAT or data["config"] != config.to_json():
                raise PlannerError(f"{path}: the checkpoint is of another network; give another folder, or remove it")
            net.load_state_dict(data["net"])
            adam.load_state_dict(data["adam"])
            self.epoch, self.step, self.seconds, self.best = (data[k] for k in ("epoch", "step", "seconds", "best"))
        except PlannerError:
            raise
        except Exception as error:  # torch.load and load_state_dict raise whatever the file makes them
            raise PlannerError(f"{path}: the checkpoint cannot be read: {error}; remove it to start anew") from error

    def rate(self, steps: int) -> float:
        """Sets and returns the learning rate for the next of ``steps`` steps."""
        rate = schedule(self.step, steps, self.how)
        for group in self.adam.param_groups:
            group["lr"] = rate
        return rate

    def tensors(self) -> dict[str, Any]:
        """The weights as arrays."""
        return {k: v.detach().cpu().numpy() for k, v in self.net.state_dict().items()}

    def save(self, row: Mapping[str, float], loss: float, about: Mapping[str, Any]) -> None:
        """Writes checkpoint, curve and weights; the best ones where ``loss`` is the least so far.

        Args:
            row: a line of the curve, by ``COLUMNS``.
            loss: what the best weights are chosen by.
            about: what else the weights files shall tell.
        """
        told = {"training": self.how.to_json(), **row, **about}
        half = isinstance(self.config, PaperConfig)  # there is one for each data set
        write(self.folder / "last.safetensors", self.config, self.tensors(), told, half=half)
        if loss <= self.best:
            self.best = loss
            write(self.folder / "best.safetensors", self.config, self.tensors(), told, half=half)
        curve = self.folder / "curve.csv"
        rows: list[dict[str, Any]] = []
        if curve.exists():  # a row that was written just before an interruption is written again
            with curve.open(newline="") as file:
                rows = [r for r in csv.DictReader(file) if int(r["epoch"]) < row["epoch"]]
        with curve.open("w", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS)
            writer.writeheader()
            writer.writerows([*rows, row])
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
                "best": self.best,
            },
            part,
        )
        part.replace(self.folder / "checkpoint.pt")  # last: it says that all of the others are there
