"""Network ``plus`` without torch: the same numbers as ``plus_net``, one decision at a time, in single precision."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.policy.features_kernel import View
from planner.policy.jit import fast_jit

Singles = NDArray[np.float32]
FORBIDDEN = np.float32(-1e9)
ONE, HALF = np.float32(1.0), np.float32(0.5)


class Weights(NamedTuple):
    """Weights, transposed for ``x @ w``; L layers, width d, hidden width f, h heads.

    Attributes:
        task, site, uav, ugv: input projections, (features, d).
        first: their biases, (4, d).
        norms: scale and shift before attention, before the feed-forward part, (L, 4, d).
        qkv: (L, d, 3 d), the queries scaled by the root of a head's width.
        out: (L, d, d).
        out_b: (L, d).
        up: (L, d, f).
        up_b: (L, f).
        down: (L, f, d).
        down_b: (L, d).
        edge: of heads and pairs of types: constant, per flying distance, per driving time, (L, 3, h, 16).
        shut: 1 for pairs of types without edges, (16,).
        norm: last scale and shift, (2, d).
        query: (d, d).
        point: of tasks, sites, UGVs, done, (4, d, d).
        pair: (N_PAIR, d).
        biases: of query, pair, done, (3, d).
        score: (d,).
    """

    task: Singles
    site: Singles
    uav: Singles
    ugv: Singles
    first: Singles
    norms: Singles
    qkv: Singles
    out: Singles
    out_b: Singles
    up: Singles
    up_b: Singles
    down: Singles
    down_b: Singles
    edge: Singles
    shut: NDArray[np.uint8]
    norm: Singles
    query: Singles
    point: Singles
    pair: Singles
    biases: Singles
    score: Singles


class Room(NamedTuple):
    """Buffers for up to N nodes.

    Attributes:
        x, y: (N, d).
        z: (N, 3 d).
        f: (N, hidden).
        heads: queries, keys transposed, values of one head, (3, N * width).
        score: (N * N,).
        whole: the same buffer as whole numbers, for the exponential.
        fly, drive: between nodes, (N, N).
        hold: (N, d), what the sites add to meetings' logits.
        at: first node of each type and the end, (5,).
    """

    x: Singles
    y: Singles
    z: Singles
    f: Singles
    heads: Singles
    score: Singles
    whole: NDArray[np.int32]
    fly: Singles
    drive: Singles
    hold: Singles
    at: NDArray[np.int64]


@fast_jit
def _norm(x: Singles, scale: Singles, shift: Singles, out: Singles) -> None:
    n, d = x.shape
    for i in range(n):
        mean = np.float32(0.0)
        for k in range(d):
            mean += x[i, k]
        mean /= np.float32(d)
        spread = np.float32(0.0)
        for k in range(d):
            spread += (x[i, k] - mean) * (x[i, k] - mean)
        inverse = ONE / np.sqrt(spread / np.float32(d) + np.float32(1e-5))
        for k in range(d):
            out[i, k] = (x[i, k] - mean) * inverse * scale[k] + shift[k]


@fast_jit
def _exp(x: Singles, whole: NDArray[np.int32]) -> None:
    """Exponentials in place, of numbers up to 0, to 2e-7 of the value; ``whole`` is the same memory.

    2^n by writing the exponent, 2^f for the fraction by a polynomial: loops that the compiler turns into vectors.
    """
    for i in range(x.shape[0]):
        t = max(x[i] * np.float32(1.4426950408889634), np.float32(-120.0))
        n = np.floor(t + HALF)
        f = t - n
        p = np.float32(1.5403530393e-4)
        p = p * f + np.float32(1.3333558146e-3)
        p = p * f + np.float32(9.6181291076e-3)
        p = p * f + np.float32(5.5504108665e-2)
        p = p * f + np.float32(2.4022650696e-1)
        p = p * f + np.float32(6.9314718056e-1)
        p = p * f + ONE
        x[i] = p
        whole[i] = whole[i] + (np.int32(n) << np.int32(23))


@fast_jit
def _attend(w: Weights, room: Room, layer: int, n: int) -> None:
    """Attention of all heads; reads queries, keys and values in ``room.z``, writes to ``room.y``."""
    d = room.x.shape[1]
    heads = w.edge.shape[2]
    width = d // heads
    at = room.at
    z = room.z
    q = room.heads[0, : n * width].reshape((n, width))
    k = room.heads[1, : n * width].reshape((width, n))
    v = room.heads[2, : n * width].reshape((n, width))
    score = room.score[: n * n].reshape((n, n))
    for h in range(heads):
        for i in range(n):
            for c in range(width):
                q[i, c] = z[i, h * width + c]
                v[i, c] = z[i, 2 * d + h * width + c]
        for c in range(width):
            for i in range(n):
                k[c, i] = z[i, d + h * width + c]
        np.dot(q, k, score)
        edge = w.edge[layer]
        for a in range(4):
            for b in range(4):
                r = 4 * a + b
                if w.shut[r] != 0:
                    score[at[a] : at[a + 1], at[b] : at[b + 1]] = FORBIDDEN
                    continue
                e0, e1, e2 = edge[0, h, r], edge[1, h, r], edge[2, h, r]
                for i in range(at[a], at[a + 1]):
                    for j in range(at[b], at[b + 1]):
                        score[i, j] += e0 + e1 * room.fly[i, j] + e2 * room.drive[i, j]
        for i in range(n):
            most = score[i, 0]
            for j in range(1, n):
                most = max(most, score[i, j])
            for j in range(n):
                score[i, j] -= most
        _exp(room.score[: n * n], room.whole[: n * n])
        for i in range(n):
            total = np.float32(0.0)
            for j in range(n):
                total += score[i, j]
            total = ONE / total
            for j in range(n):
                score[i, j] *= total
        np.dot(score, v, q)
        for i in range(n):
            for c in range(width):
                room.y[i, h * width + c] = q[i, c]


@fast_jit
def _edges(view: View, room: Room) -> int:
    """Puts the nodes' places and the lengths of all edges into ``room``; the number of nodes."""
    at = room.at
    at[0] = 0
    for t in range(4):
        at[t + 1] = at[t] + view.counts[t]
    n = at[4]
    x, y = room.heads[0], room.heads[1]  # not used yet
    for t in range(4):
        for i in range(view.counts[t]):
            if t == 0:
                x[at[t] + i], y[at[t] + i] = view.task[i, 0], view.task[i, 1]
            elif t == 1:
                x[at[t] + i], y[at[t] + i] = view.site[i, 0], view.site[i, 1]
            elif t == 2:
                x[at[t] + i], y[at[t] + i] = view.uav[i, 0], view.uav[i, 1]
            else:
                x[at[t] + i], y[at[t] + i] = view.ugv[i, 0], view.ugv[i, 1]
    for i in range(n):
        for j in range(n):
            dx, dy = x[i] - x[j], y[i] - y[j]
            room.fly[i, j] = np.sqrt(dx * dx + dy * dy)
            room.drive[i, j] = np.float32(0.0)
    n_sites = view.counts[1]
    for i in range(n_sites):
        for j in range(n_sites):
            room.drive[at[1] + i, at[1] + j] = view.drive[i, j]
        for g in range(view.counts[3]):
            room.drive[at[3] + g, at[1] + i] = view.drive[n_sites + g, i]
            room.drive[at[1] + i, at[3] + g] = view.drive[n_sites + g, i]
    return int(n)


@fast_jit
def _score(row: Singles, query: Singles, weight: Singles) -> float:
    total = np.float32(0.0)
    for k in range(query.shape[0]):
        total += max(row[k] + query[k], np.float32(0.0)) * weight[k]
    return float(total)


@fast_jit
def _project(features: Singles, weight: Singles, bias: Singles, out: Singles) -> None:
    for i in range(features.shape[0]):
        out[i] = bias
        for c in range(features.shape[1]):
            f = features[i, c]
            if f != 0.0:
                for k in range(bias.shape[0]):
                    out[i, k] += f * weight[c, k]


@fast_jit
def logits(w: Weights, room: Room, view: View, visit: Singles, meet: Singles, done: Singles) -> None:
    """Logits of a decision; ``FORBIDDEN`` where not offered.

    Args:
        w: the weights.
        room: buffers, large enough for all nodes.
        view: the decision, from ``features_kernel.fill_view``.
        visit: filled for the tasks that are left, in the view's order, (>= tasks left,).
        meet: (G, n_sites).
        done: (1,).
    """
    n = _edges(view, room)
    at = room.at
    d = w.score.shape[0]
    _project(view.task[: at[1]], w.task, w.first[0], room.x[: at[1]])
    _project(view.site, w.site, w.first[1], room.x[at[1] : at[2]])
    _project(view.uav[: at[3] - at[2]], w.uav, w.first[2], room.x[at[2] : at[3]])
    _project(view.ugv, w.ugv, w.first[3], room.x[at[3] : at[4]])
    x, y, z, f = room.x[:n], room.y[:n], room.z[:n], room.f[:n]
    for layer in range(w.qkv.shape[0]):
        _norm(x, w.norms[layer, 0], w.norms[layer, 1], y)
        np.dot(y, w.qkv[layer], z)
        _attend(w, room, layer, n)
        out = room.hold[:n]
        np.dot(y, w.out[layer], out)
        for i in range(n):
            for k in range(d):
                x[i, k] += out[i, k] + w.out_b[layer, k]
        _norm(x, w.norms[layer, 2], w.norms[layer, 3], y)
        np.dot(y, w.up[layer], f)
        for i in range(n):
            for k in range(f.shape[1]):
                f[i, k] = max(f[i, k] + w.up_b[layer, k], np.float32(0.0))
        np.dot(f, w.down[layer], out)
        for i in range(n):
            for k in range(d):
                x[i, k] += out[i, k] + w.down_b[layer, k]
    _norm(x, w.norm[0], w.norm[1], y)
    me = y[at[2] : at[2] + 1]
    np.dot(me, w.query, room.x[:1])
    query = room.x[0] + w.biases[0]
    hold = room.hold
    np.dot(y[: at[1]], w.point[0], hold[: at[1]])
    for i in range(at[1]):
        visit[i] = _score(hold[i], query, w.score) if view.task[i, 5] != 0 else FORBIDDEN
    np.dot(y[at[1] : at[2]], w.point[1], hold[at[1] : at[2]])
    np.dot(y[at[3] : at[4]], w.point[2], hold[at[3] : at[4]])
    row = room.x[0]
    for g in range(view.counts[3]):
        for p in range(view.counts[1]):
            if view.pair[g, p, 0] == 0:
                meet[g, p] = FORBIDDEN
                continue
            for k in range(d):
                row[k] = hold[at[3] + g, k] + hold[at[1] + p, k] + w.biases[1, k]
            for c in range(view.pair.shape[2]):
                value = view.pair[g, p, c]
                for k in range(d):
                    row[k] += value * w.pair[c, k]
            meet[g, p] = _score(row, query, w.score)
    done[0] = FORBIDDEN
    if view.counts[4] != 0:
        np.dot(me, w.point[3], room.x[:1])
        done[0] = _score(room.x[0] + w.biases[2], query, w.score)
