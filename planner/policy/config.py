"""The networks' sizes and switches; what a weights file carries beside the weights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError


@dataclass(frozen=True, slots=True)
class PlusConfig:
    """Network ``plus``: one model for any number of tasks, path points and vehicles.

    Attributes:
        dim: width of an embedding; a multiple of ``heads``.
        heads: attention heads.
        layers: layers.
        hidden: width inside the feed-forward part of a layer.
        uav_edges: whether UAVs are connected with the other types.
        ugv_edges: whether UGVs are connected with sites and UAVs.
    """

    dim: int = 96
    heads: int = 6
    layers: int = 3
    hidden: int = 192
    uav_edges: bool = True
    ugv_edges: bool = True

    def __post_init__(self) -> None:
        for name in ("dim", "heads", "layers", "hidden"):
            value = getattr(self, name)
            if type(value) is not int or value < 1:
                raise PlannerError(f"plus: {name} is {value!r}; give a whole number of at least 1")
        if self.dim % self.heads:
            raise PlannerError(f"plus: dim is {self.dim}; give a multiple of heads, {self.heads}")

    def to_json(self) -> dict[str, Any]:
        """A JSON object."""
        return {"kind": "plus", **asdict(self)}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> PlusConfig:
        """Reads ``to_json``'s object.

        Raises:
            PlannerError: where it is not one.
        """
        return cls(**_values(cls, "plus", data))


TASK, SITE, UAV, UGV = range(4)


def connected(config: PlusConfig) -> NDArray[np.bool_]:
    """Which types' nodes attend to which in network ``plus``, (16,), by ``4 * type + type``."""
    table = np.ones((4, 4), np.bool_)
    table[TASK, UGV] = table[UGV, TASK] = False
    if not config.uav_edges:
        table[UAV, :] = table[:, UAV] = False
    if not config.ugv_edges:
        table[UGV, :] = table[:, UGV] = False
    np.fill_diagonal(table, True)
    return table.reshape(16)


@dataclass(frozen=True, slots=True)
class PaperConfig:
    """The paper's network for one data set, with a fixed list of actions; ``mlp`` is the paper's baseline.

    Attributes:
        n_tasks, n_points, n_uavs, n_ugvs: the data set's sizes; they fix the list of actions.
        graph: ``hgt`` is equations (1) to (5), ``mlp`` a multilayer perceptron on each node.
        dim: width of an embedding.
        encoder_layers, decoder_layers: numbers of layers.
        radius: of edges, as a share of the map's larger side.
        most: the longest sequence of actions.
        uav_edges, ugv_edges: whether there are such edges.
        named: whether nodes carry their number. The paper's attributes do not tell which task "visit task 3" means:
            tasks lie anywhere, and attention does not see the order of nodes. Without numbers, the position of a task
            and the number of its action have nothing to do with one another.
        by_place: whether tasks are numbered by where they lie (``graph.numbering``) instead of as they come: then
            "visit task 3" means about the same place in every problem, which makes far less to learn.
    """

    n_tasks: int
    n_points: int
    n_uavs: int
    n_ugvs: int
    graph: str = "hgt"
    dim: int = 128
    encoder_layers: int = 3
    decoder_layers: int = 3
    radius: float = 0.5
    most: int = 192
    uav_edges: bool = True
    ugv_edges: bool = True
    named: bool = True
    by_place: bool = False

    def __post_init__(self) -> None:
        for name in ("n_tasks", "n_points", "n_uavs", "dim", "encoder_layers", "decoder_layers", "most"):
            value = getattr(self, name)
            if type(value) is not int or value < 1:
                raise PlannerError(f"paper: {name} is {value!r}; give a whole number of at least 1")
        if self.graph not in ("hgt", "mlp"):
            raise PlannerError(f"paper: graph is {self.graph!r}; give hgt or mlp")

    def to_json(self) -> dict[str, Any]:
        """A JSON object."""
        return {"kind": "paper", **asdict(self)}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> PaperConfig:
        """Reads ``to_json``'s object.

        Raises:
            PlannerError: where it is not one.
        """
        return cls(**_values(cls, "paper", data))


def _values(cls: Any, kind: str, data: Mapping[str, Any]) -> dict[str, Any]:
    values = {k: v for k, v in data.items() if k != "kind"}
    every = {f.name for f in fields(cls)}
    needed = {f.name for f in fields(cls) if f.default is MISSING}
    if data.get("kind") != kind or set(values) - every or needed - set(values):
        raise PlannerError(f"this is no configuration of a network {kind!r}: {dict(data)}")
    return values
