"""The paper's networks in torch by equation numbers: heterogeneous graph transformer psi, decoder phi, baseline MLP.

Where the paper leaves something open: edges lead to UAVs and to UGVs as equations (3) and (4) have it, a node's own
edge is among the intra edges, scores are normalised over each set of edges apart, the first embedding h^0 is z (and the
node's number, see ``PaperConfig.named``), and the sequence begins with a start symbol. Beyond the paper: the numbers,
that they tell where a task lies (``PaperConfig.by_place``), and the first weights (``_begin``); graph and MLP have them
alike. ``paper_numpy`` computes the same without torch.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as fn

from planner.plan import Move, Visit
from planner.policy.config import PaperConfig
from planner.policy.graph import action_of, n_actions


class Graphs(NamedTuple):
    """Graphs of several problems as tensors; members as in ``graph.Graph`` with a first axis."""

    task: Tensor
    point: Tensor
    uav: Tensor
    ugv: Tensor
    intra: Tensor
    uav_edges: Tensor
    ugv_edges: Tensor


def attend(q: Tensor, k: Tensor, v: Tensor, edges: Tensor) -> Tensor:
    """sum_j softmax_j(q_i . k_j / sqrt(d)) v_j over the edges (i, j); 0 for nodes without any. (B, N, d)."""
    score = (q @ k.transpose(-1, -2)) * q.shape[-1] ** -0.5
    weight = score.masked_fill(~edges, -1e9).softmax(-1) * edges.any(-1, keepdim=True)
    out: Tensor = weight @ v
    return out


class GraphLayer(nn.Module):
    """Equations (1) to (5)."""

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.q = nn.Linear(dim, dim, bias=False)
        self.k = nn.Linear(dim, dim, bias=False)
        self.v = nn.Linear(dim, dim, bias=False)
        self.norm = nn.LayerNorm(dim)

    def forward(self, h: Tensor, g: Graphs) -> Tensor:
        """Embeddings of one layer to those of the next, (B, N, d)."""
        q, k, v = self.q(h), self.k(h), self.v(h)  # (1)
        same = attend(q, k, v, g.intra)  # (2), alpha
        of_uav = attend(q, k, v, g.uav_edges)  # (3), beta^a
        of_ugv = attend(q, k, v, g.ugv_edges)  # (4), beta^g
        after: Tensor = self.norm(h + same + of_uav + of_ugv)  # (5)
        return after


class DecoderLayer(nn.Module):
    """Equations (6) to (10)."""

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.q_o = nn.Linear(dim, dim, bias=False)
        self.k_o = nn.Linear(dim, dim, bias=False)
        self.v_o = nn.Linear(dim, dim, bias=False)
        self.q_c = nn.Linear(dim, dim, bias=False)
        self.k_c = nn.Linear(dim, dim, bias=False)
        self.v_c = nn.Linear(dim, dim, bias=False)
        self.norm = nn.LayerNorm(dim)

    def forward(self, f: Tensor, h: Tensor, past: Tensor) -> Tensor:
        """Hidden representations of one layer to those of the next, (B, T, d), given the graph's, (B, N, d)."""
        said = attend(self.q_o(f), self.k_o(f), self.v_o(f), past)  # (6), (7)
        every = torch.ones(1, f.shape[1], h.shape[1], dtype=torch.bool, device=f.device)
        seen = attend(self.q_c(f), self.k_c(h), self.v_c(h), every)  # (8), (9)
        after: Tensor = self.norm(f + said + seen)  # (10)
        return after


class PaperNet(nn.Module):
    """psi (or an MLP in its place) and phi: logits of the next action after every prefix of a sequence."""

    def __init__(self, config: PaperConfig) -> None:
        super().__init__()
        d = config.dim
        self.config = config
        self.task = nn.Linear(3, d)  # z_i = W^z t_i, one W^z for each type
        self.point = nn.Linear(2, d)
        self.uav = nn.Linear(3, d)
        self.ugv = nn.Linear(2 + 2 * config.n_uavs, d)
        if config.graph == "hgt":
            self.layers = nn.ModuleList(GraphLayer(d) for _ in range(config.encoder_layers))
        else:
            self.layers = nn.ModuleList(nn.Linear(d, d) for _ in range(config.encoder_layers))
        if config.named:
            n_nodes = config.n_tasks + config.n_points + 1 + config.n_uavs + config.n_ugvs
            self.name = nn.Embedding(n_nodes, d)
        size = n_actions(config)
        self.action = nn.Embedding(size + 1, d)  # E^a; the last one is the start symbol
        self.place = nn.Embedding(config.most, d)  # E^i
        self.decoder = nn.ModuleList(DecoderLayer(d) for _ in range(config.decoder_layers))
        self.out = nn.Linear(d, size, bias=False)  # W^u
        if config.named:
            self._begin()

    @torch.no_grad()
    def _begin(self) -> None:
        """First weights from which less is to be found out; trained like all others.

        The usual ones say nothing of which number belongs to which action. Here numbers and words begin small, which
        lets positions through; cross-attention begins by copying what it looks at; and W^u begins with the numbers of
        the nodes that an action is about, so that what is copied from a node points at its actions.
        """
        c, first_uav = self.config, self.config.n_tasks + self.config.n_points + 1
        self.name.weight *= 0.1
        self.action.weight *= 0.3
        self.place.weight *= 0.3
        for layer in self.decoder:
            assert isinstance(layer, DecoderLayer)
            nn.init.eye_(layer.v_c.weight)
        for index in range(n_actions(c)):
            act = action_of(index, c)
            if isinstance(act, Visit):
                nodes = [act.task, first_uav + act.uav]
            elif isinstance(act, Move):
                site = c.n_points if act.path_point is None else act.path_point
                nodes = [c.n_tasks + site, first_uav + c.n_uavs + act.ugv]
            else:
                nodes = [first_uav + act.uav, first_uav + c.n_uavs + act.ugv]
            self.out.weight[index] = 0.5 * fn.normalize(self.name.weight[nodes].sum(dim=0), dim=0)

    def encode(self, g: Graphs) -> Tensor:
        """Embeddings H of all nodes, (B, N, d)."""
        h = torch.cat([self.task(g.task), self.point(g.point), self.uav(g.uav), self.ugv(g.ugv)], dim=1)
        if self.config.named:
            h = h + self.name.weight
        for layer in self.layers:
            h = layer(h, g) if self.config.graph == "hgt" else fn.relu(layer(h))
        return h

    def forward(self, g: Graphs, said: Tensor) -> Tensor:
        """Logits u_1 .. u_T+1 of the next action, (B, T + 1, actions), after each prefix of ``said``, (B, T)."""
        h = self.encode(g)
        begin = torch.full_like(said[:, :1], self.action.num_embeddings - 1)
        sequence = torch.cat([begin, said], dim=1)
        n = sequence.shape[1]
        f = self.action(sequence) + self.place.weight[:n]
        past = torch.ones(n, n, dtype=torch.bool, device=f.device).tril()[None]
        for layer in self.decoder:
            f = layer(f, h, past)
        logits: Tensor = self.out(f)
        return logits
