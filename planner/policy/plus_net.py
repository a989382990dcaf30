"""Network ``plus`` in torch, for training. ``plus_kernel`` computes the same without torch.

It keeps the paper's plan, a heterogeneous graph transformer and a decoder that attends to its embeddings, and changes
four things:

- The graph is encoded anew at every decision, as it then stands: visited tasks are gone, vehicles are where and when
  they will be. So the decoder needs no memory of what was decided (equations 6, 7 and the causal part of 10): the
  simulated state says more exactly what these would have to learn. Replanning in flight is the same as planning.
- Features and edges are relative to the UAV whose turn it is and have no dimension (``features_kernel``). Edges carry
  distances: attention scores get a bias that is linear in the flying distance and the driving time, for each pair of
  types and each head, instead of a cut at a radius.
- A layer is pre-normed and has a feed-forward part.
- Logits point at nodes (task; UGV and site; the UAV itself for ``done``), so there is no list of actions to outgrow.

As in the paper, UGVs and tasks are not connected: tasks may lie where no road leads.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as fn

from planner.policy.config import PlusConfig, connected
from planner.policy.features_kernel import N_PAIR, N_SITE, N_TASK, N_UAV, N_UGV

FORBIDDEN = -1e9


class Batch(NamedTuple):
    """Decisions, padded to the largest of each count; see ``features_kernel.View``.

    Attributes:
        task: (B, M, N_TASK).
        site: (B, S, N_SITE).
        uav: (B, U, N_UAV), the one whose turn it is first.
        ugv: (B, G, N_UGV).
        pair: (B, G, S, N_PAIR).
        drive: (B, S + G, S); where sites are padded, the UGVs' rows come after the padded sites.
        counts: tasks, sites, UAVs, UGVs, whether done is offered, (B, 5).
    """

    task: Tensor
    site: Tensor
    uav: Tensor
    ugv: Tensor
    pair: Tensor
    drive: Tensor
    counts: Tensor


class Layer(nn.Module):
    """Attention along edges (equations 1 to 5) and a feed-forward part, both residual and pre-normed."""

    def __init__(self, config: PlusConfig) -> None:
        super().__init__()
        d = config.dim
        self.heads = config.heads
        self.norm_a = nn.LayerNorm(d)
        self.qkv = nn.Linear(d, 3 * d, bias=False)
        self.out = nn.Linear(d, d)
        self.norm_b = nn.LayerNorm(d)
        self.up = nn.Linear(d, config.hidden)
        self.down = nn.Linear(config.hidden, d)
        # of each head and pair of types: constant, per flying distance, per driving time
        self.edge = nn.Parameter(torch.zeros(3, config.heads, 16))
        nn.init.normal_(self.edge, std=0.3)

    def forward(self, x: Tensor, relation: Tensor, fly: Tensor, drive: Tensor, shut: Tensor) -> Tensor:
        """(B, N, d) to (B, N, d); relation, fly, drive and shut (no edge) are (B or 1, N, N)."""
        b, n, d = x.shape
        q, k, v = self.qkv(self.norm_a(x)).reshape(b, n, 3, self.heads, d // self.heads).permute(2, 0, 3, 1, 4)
        constant, per_fly, per_drive = self.edge[:, :, relation]  # (heads, N, N) each
        score = (q @ k.transpose(-1, -2)) * (d // self.heads) ** -0.5
        score = score + constant + per_fly * fly[:, None] + per_drive * drive[:, None]
        weight = score.masked_fill(shut[:, None], FORBIDDEN).softmax(-1)
        x = x + self.out((weight @ v).transpose(1, 2).reshape(b, n, d))
        after: Tensor = x + self.down(fn.relu(self.up(self.norm_b(x))))
        return after


class PlusNet(nn.Module):
    """Logits of what the UAV whose turn it is does next."""

    def __init__(self, config: PlusConfig) -> None:
        super().__init__()
        d = config.dim
        self.config = config
        self.task = nn.Linear(N_TASK, d)  # z = W^z t, one W^z for each type
        self.site = nn.Linear(N_SITE, d)
        self.uav = nn.Linear(N_UAV, d)
        self.ugv = nn.Linear(N_UGV, d)
        self.layers = nn.ModuleList(Layer(config) for _ in range(config.layers))
        self.norm = nn.LayerNorm(d)
        self.query = nn.Linear(d, d)
        self.point_task = nn.Linear(d, d, bias=False)
        self.point_site = nn.Linear(d, d, bias=False)
        self.point_ugv = nn.Linear(d, d, bias=False)
        self.point_pair = nn.Linear(N_PAIR, d)
        self.point_done = nn.Linear(d, d)
        self.score = nn.Linear(d, 1, bias=False)
        self.edges: Tensor
        self.register_buffer("edges", torch.from_numpy(connected(config)), persistent=False)

    def forward(self, batch: Batch) -> Tensor:
        """Logits, (B, M + G * S + 1): visits, meetings, done; ``FORBIDDEN`` where not offered."""
        m, s, u, g = batch.task.shape[1], batch.site.shape[1], batch.uav.shape[1], batch.ugv.shape[1]
        parts = (self.task(batch.task), self.site(batch.site), self.uav(batch.uav), self.ugv(batch.ugv))
        x = torch.cat(parts, dim=1)
        kind = torch.cat([torch.full((n,), i, device=x.device) for i, n in enumerate((m, s, u, g))])
        relation = 4 * kind[:, None] + kind[None, :]
        at = torch.cat([batch.task[..., :2], batch.site[..., :2], batch.uav[..., :2], batch.ugv[..., :2]], dim=1)
        step = at[:, :, None] - at[:, None]
        fly = (step.square().sum(-1) + 1e-12).sqrt()
        between, to_sites = batch.drive[:, :s], batch.drive[:, s:]
        of_sites = torch.cat([fn.pad(between, (m, u)), to_sites.transpose(1, 2)], dim=2)
        of_ugvs = fn.pad(to_sites, (m, u + g))
        drive = torch.cat([fn.pad(of_sites, (0, 0, m, u)), of_ugvs], dim=1)
        sizes = torch.cat([
            torch.arange(n, device=x.device)[None] >= batch.counts[:, i : i + 1] for i, n in enumerate((m, s, u, g))
        ], dim=1)  # fmt: skip
        shut = sizes[:, None, :] | ~self.edges[relation]
        for layer in self.layers:
            x = layer(x, relation, fly, drive, shut)
        x = self.norm(x)
        tasks, sites, me, ugvs = x[:, :m], x[:, m : m + s], x[:, m + s], x[:, m + s + u :]
        query = self.query(me)
        visit = self.score(fn.relu(self.point_task(tasks) + query[:, None]))[..., 0]
        meet = self.point_ugv(ugvs)[:, :, None] + self.point_site(sites)[:, None] + self.point_pair(batch.pair)
        meet = self.score(fn.relu(meet + query[:, None, None]))[..., 0]
        done = self.score(fn.relu(self.point_done(me) + query))
        visit = visit.masked_fill((batch.task[..., 5] == 0) | sizes[:, :m], FORBIDDEN)
        meet = meet.masked_fill(batch.pair[..., 0] == 0, FORBIDDEN)
        done = done.masked_fill(batch.counts[:, 4:] == 0, FORBIDDEN)
        return torch.cat([visit, meet.flatten(1), done], dim=1)
