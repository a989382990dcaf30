"""The paper's networks without torch: the same numbers as ``paper_net``, with a cache of keys and values."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.policy.config import PaperConfig
from planner.policy.graph import Graph
from planner.policy.weights import Tensors

Singles = NDArray[np.float32]


def _norm(x: Singles, scale: Singles, shift: Singles) -> Singles:
    step = x - x.mean(axis=-1, keepdims=True)
    spread = (step * step).mean(axis=-1, keepdims=True)
    return np.asarray(step / np.sqrt(spread + np.float32(1e-5)) * scale + shift, np.float32)


def _softmax(x: Singles) -> Singles:
    x = np.exp(x - x.max(axis=-1, keepdims=True))
    return np.asarray(x / x.sum(axis=-1, keepdims=True), np.float32)


class PaperModel:
    """Weights of ``paper_net.PaperNet``, ready to compute with."""

    def __init__(self, config: PaperConfig, tensors: Tensors) -> None:
        """Takes weights by name.

        Raises:
            PlannerError: where one is missing.
        """
        self.config = config
        self.w = {name: np.asarray(value, np.float32) for name, value in tensors.items()}
        missing = [
            name for name in ("task.weight", "action.weight", "place.weight", "out.weight") if name not in self.w
        ]
        if missing or f"decoder.{config.decoder_layers - 1}.q_o.weight" not in self.w:
            raise PlannerError(f"weights of network paper: {', '.join(missing) or 'a decoder layer'} is missing")

    def _linear(self, name: str, x: Singles) -> Singles:
        y = x @ self.w[f"{name}.weight"].T
        return y + self.w[f"{name}.bias"] if f"{name}.bias" in self.w else y

    def encode(self, g: Graph) -> Singles:
        """Embeddings H of all nodes, (N, d): equations (1) to (5), or the MLP."""
        parts = (("task", g.task), ("point", g.point), ("uav", g.uav), ("ugv", g.ugv))
        h = np.concatenate([self._linear(name, t) for name, t in parts])
        if self.config.named:
            h = h + self.w["name.weight"]
        for i in range(self.config.encoder_layers):
            if self.config.graph == "mlp":
                h = np.maximum(self._linear(f"layers.{i}", h), 0.0)
                continue
            q, k, v = (self._linear(f"layers.{i}.{x}", h) for x in "qkv")
            score = q @ k.T * np.float32(self.config.dim**-0.5)
            total = h
            for edges in (g.intra, g.uav_edges, g.ugv_edges):
                weight = _softmax(np.where(edges, score, np.float32(-1e9))) * edges.any(axis=1, keepdims=True)
                total = total + weight @ v
            h = _norm(total, self.w[f"layers.{i}.norm.weight"], self.w[f"layers.{i}.norm.bias"])
        return h

    def begin(self, h: Singles) -> Saying:
        """A sequence with nothing said yet, on the graph with embeddings ``h``."""
        return Saying(self, h)


class Saying:
    """A sequence of actions as it grows: keys and values of all layers so far, (t, d) each."""

    def __init__(self, model: PaperModel, h: Singles) -> None:
        c = model.config
        self.model = model
        self.t = 0
        layers = range(c.decoder_layers)
        self.k_c = [model._linear(f"decoder.{i}.k_c", h) for i in layers]
        self.v_c = [model._linear(f"decoder.{i}.v_c", h) for i in layers]
        self.k_o = np.zeros((c.decoder_layers, c.most, c.dim), np.float32)
        self.v_o = np.zeros((c.decoder_layers, c.most, c.dim), np.float32)

    def next(self, last: int | None) -> Singles:
        """Logits u_t of the next action, (actions,), equations (6) to (10), after ``last`` (None at the beginning).

        Raises:
            PlannerError: where the sequence is longer than the network can say.
        """
        m, c, t = self.model, self.model.config, self.t
        if t >= c.most:
            raise PlannerError(f"the plan is longer than the {c.most} actions that this network can say")
        table = m.w["action.weight"]
        f = table[len(table) - 1 if last is None else last] + m.w["place.weight"][t]
        scale = np.float32(c.dim**-0.5)
        for i in range(c.decoder_layers):
            name = f"decoder.{i}"
            self.k_o[i, t] = m._linear(f"{name}.k_o", f)
            self.v_o[i, t] = m._linear(f"{name}.v_o", f)
            said = _softmax(self.k_o[i, : t + 1] @ m._linear(f"{name}.q_o", f) * scale) @ self.v_o[i, : t + 1]
            seen = _softmax(self.k_c[i] @ m._linear(f"{name}.q_c", f) * scale) @ self.v_c[i]
            f = _norm(f + said + seen, m.w[f"{name}.norm.weight"], m.w[f"{name}.norm.bias"])
        self.t = t + 1
        return m._linear("out", f)
