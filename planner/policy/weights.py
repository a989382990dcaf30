"""Weights files: safetensors with the configuration inside, written by training, read without torch."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from planner.errors import PlannerError
from planner.policy.config import PaperConfig, PlusConfig, connected
from planner.policy.features_kernel import N_PAIR, N_SITE, N_TASK, N_UAV, N_UGV
from planner.policy.plus_kernel import Room, Weights

FORMAT = "copcs-policy/1"
Tensors = Mapping[str, NDArray[np.float32]]


def write(
    path: Path, config: PlusConfig | PaperConfig, tensors: Tensors, about: Mapping[str, Any], *, half: bool = False
) -> str:
    """Writes a weights file, whole or not at all; its SHA-256.

    Args:
        path: where to.
        config: the network's.
        tensors: its weights by name, as ``state_dict`` has them.
        about: how they were made (data, seed, losses); kept in the file.
        half: in half precision, for files that are many.
    """
    kept = {k: np.ascontiguousarray(v, dtype=np.float16 if half else np.float32) for k, v in tensors.items()}
    more = {"format": FORMAT, "config": json.dumps(config.to_json()), "about": json.dumps(dict(about))}
    data = save(kept, metadata=more)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_bytes(data)
    part.replace(path)
    return hashlib.sha256(data).hexdigest()


def read(
    path: Path, sha256: str | None = None
) -> tuple[PlusConfig | PaperConfig, dict[str, NDArray[np.float32]], dict[str, Any]]:
    """Reads a weights file: configuration, weights, how they were made.

    Raises:
        PlannerError: where the file is missing, damaged, of another format, or has another hash than ``sha256``.
    """
    try:
        if sha256 is not None and hashlib.sha256(path.read_bytes()).hexdigest() != sha256:
            raise PlannerError(f"{path}: the weights are not the ones expected (hash differs); fetch the file again")
        with safe_open(path, "numpy") as file:
            more = file.metadata() or {}
            names = list(file.keys())
            tensors = {name: file.get_tensor(name).astype(np.float32, copy=False) for name in names}
    except (OSError, SafetensorError) as error:
        raise PlannerError(f"{path}: the weights cannot be read: {error}") from error
    if more.get("format") != FORMAT:
        raise PlannerError(f"{path}: format is {more.get('format')!r}; this program reads {FORMAT!r}")
    try:
        config, about = dict(json.loads(more["config"])), dict(json.loads(more["about"]))
    except (KeyError, TypeError, ValueError) as error:
        raise PlannerError(f"{path}: the weights' configuration cannot be read: {error!r}") from error
    if not all(np.isfinite(x).all() for x in tensors.values()):
        raise PlannerError(f"{path}: some weights are no numbers; train again")
    kind = PaperConfig if config.get("kind") == "paper" else PlusConfig
    return kind.from_json(config), tensors, about


def plus_weights(config: PlusConfig, tensors: Tensors) -> Weights:
    """Weights of network ``plus`` as the kernel takes them.

    Raises:
        PlannerError: where a tensor is missing or has a wrong shape.
    """
    d, f, layers = config.dim, config.hidden, range(config.layers)

    def get(name: str, *shape: int) -> NDArray[np.float32]:
        if name not in tensors or tensors[name].shape != shape:
            have = tensors[name].shape if name in tensors else "missing"
            raise PlannerError(f"weights of network plus: {name} is {have}; it should be {shape}")
        return np.asarray(tensors[name], dtype=np.float32)

    def turned(name: str, rows: int, columns: int) -> NDArray[np.float32]:
        return np.ascontiguousarray(get(name, rows, columns).T)

    def each(name: str, *shape: int) -> NDArray[np.float32]:
        return np.stack([get(f"layers.{i}.{name}", *shape) for i in layers])

    qkv = np.stack([turned(f"layers.{i}.qkv.weight", 3 * d, d) for i in layers])
    qkv[:, :, :d] *= np.float32((d // config.heads) ** -0.5)
    norms = [each(f"{n}.{part}", d) for n in ("norm_a", "norm_b") for part in ("weight", "bias")]
    return Weights(
        turned("task.weight", d, N_TASK),
        turned("site.weight", d, N_SITE),
        turned("uav.weight", d, N_UAV),
        turned("ugv.weight", d, N_UGV),
        np.stack([get(f"{name}.bias", d) for name in ("task", "site", "uav", "ugv")]),
        np.ascontiguousarray(np.stack(norms, axis=1)),
        qkv,
        np.stack([turned(f"layers.{i}.out.weight", d, d) for i in layers]),
        each("out.bias", d),
        np.stack([turned(f"layers.{i}.up.weight", f, d) for i in layers]),
        each("up.bias", f),
        np.stack([turned(f"layers.{i}.down.weight", d, f) for i in layers]),
        each("down.bias", d),
        each("edge", 3, config.heads, 16),
        (~connected(config)).astype(np.uint8),
        np.stack([get("norm.weight", d), get("norm.bias", d)]),
        turned("query.weight", d, d),
        np.stack([turned(f"point_{name}.weight", d, d) for name in ("task", "site", "ugv", "done")]),
        turned("point_pair.weight", d, N_PAIR),
        np.stack([get(f"{name}.bias", d) for name in ("query", "point_pair", "point_done")]),
        get("score.weight", 1, d)[0].copy(),
    )


def room(config: PlusConfig, n_nodes: int) -> Room:
    """Buffers for decisions with up to ``n_nodes`` nodes."""
    n, d = max(2, n_nodes), config.dim
    f = np.float32
    score = np.zeros(n * n, f)
    return Room(
        np.zeros((n, d), f),
        np.zeros((n, d), f),
        np.zeros((n, 3 * d), f),
        np.zeros((n, config.hidden), f),
        np.zeros((3, n * (d // config.heads)), f),
        score,
        score.view(np.int32),
        np.zeros((n, n), f),
        np.zeros((n, n), f),
        np.zeros((n, d), f),
        np.zeros(5, np.int64),
    )
