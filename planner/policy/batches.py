"""Batches of decisions for training, made from examples by replaying their plans."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from planner.arrays import new_work
from planner.kernel import Ints
from planner.policy.examples import Example
from planner.policy.features_kernel import N_PAIR, N_SITE, N_TASK, N_UAV, N_UGV, Indices, Singles
from planner.policy.replay_kernel import replay
from planner.policy.state import SYMMETRIES, new_turn


class Pool(NamedTuple):
    """Decisions, padded to one size; members as in ``features_kernel.View``, with a first axis.

    ``option`` has the expert's choices, (B, U): the one taken, then those of UAVs that are alike, -1 behind the last;
    numbered for the padded sizes: M tasks that are left, G * S meetings, done.
    """

    task: Singles
    site: Singles
    uav: Singles
    ugv: Singles
    pair: Singles
    drive: Singles
    counts: Indices
    option: Ints

    def take(self, rows: Ints) -> Pool:
        """Some of the decisions, cut to the size that they need."""
        counts = self.counts[rows]
        m, s, u, g = (int(x) for x in np.maximum(counts[:, :4].max(axis=0), 1))
        most_s, most_g, most_m = self.site.shape[1], self.ugv.shape[1], self.task.shape[1]
        option = self.option[rows].astype(np.int64)
        meeting = option - most_m
        g_of, p_of = meeting // most_s, meeting % most_s
        option = np.where(
            meeting < 0, option, np.where(meeting == most_g * most_s, m + g * s, m + g_of * s + p_of)
        )  # fmt: skip
        drive = self.drive[rows]
        return Pool(
            self.task[rows, :m],
            self.site[rows, :s],
            self.uav[rows, :u],
            self.ugv[rows, :g],
            self.pair[rows, :g, :s],
            np.concatenate([drive[:, :s, :s], drive[:, most_s : most_s + g, :s]], axis=1),
            counts,
            option.astype(np.int32),
        )


def pool(examples: Sequence[Example], symmetries: Sequence[int], angles: Sequence[float] | None = None) -> Pool:
    """All decisions of some examples.

    Args:
        examples: the plans.
        symmetries: how each is turned or mirrored (0 leaves it).
        angles: from which UAVs that are alike are ordered in each, in rad from east; None: east.
    """
    total = sum(e.steps for e in examples)
    most_m = max(len(e.world.visited) for e in examples)
    most_s = max(e.world.road.shape[1] for e in examples)
    most_u = max(len(e.world.uavs) for e in examples)
    most_g = max(1, *(len(e.world.ugvs) for e in examples))
    f = np.float32
    made = Pool(
        np.zeros((total, most_m, N_TASK), f),
        np.zeros((total, most_s, N_SITE), f),
        np.zeros((total, most_u, N_UAV), f),
        np.zeros((total, most_g, N_UGV), f),
        np.zeros((total, most_g, most_s, N_PAIR), f),
        np.zeros((total, most_s + most_g, most_s), f),
        np.zeros((total, 5), np.int32),
        np.full((total, most_u), -1, np.int32),
    )
    tasks = np.zeros((total, most_m), np.int32)
    row = 0
    for e, k, angle in zip(examples, symmetries, angles or [0.0] * len(examples), strict=True):
        w = e.world
        n_tasks, n_sites, n_uavs, n_ugvs = len(w.visited), w.road.shape[1], len(w.uavs), len(w.ugvs)
        options, order = np.zeros((e.steps, n_uavs), np.int32), np.zeros(e.steps, np.int64)
        turn = new_turn(n_tasks, n_sites, n_uavs, n_ugvs)
        drive = np.zeros((e.steps, n_sites + n_ugvs, n_sites), f)
        xy = np.ascontiguousarray(e.xy @ SYMMETRIES[k])
        n = replay(
            w, new_work(w), turn, xy, e.reach, e.codes, angle, options, order,
            made.task[row : row + e.steps], made.site[row : row + e.steps], made.uav[row : row + e.steps],
            made.ugv[row : row + e.steps], made.pair[row : row + e.steps], drive, tasks[row : row + e.steps],
            made.counts[row : row + e.steps], 0,
        )  # fmt: skip
        # The order of UAVs that are alike can depend on the orientation; the number of decisions hardly ever does.
        n = max(n, 0)
        made.drive[row : row + n, :n_sites, :n_sites] = drive[:n, :n_sites]
        made.drive[row : row + n, most_s : most_s + n_ugvs, :n_sites] = drive[:n, n_sites:]
        for i in range(n):
            left = int(made.counts[row + i, 0])
            for column, option in enumerate(options[i].tolist()):
                if option < 0:
                    break
                if option < n_tasks:
                    to = int(np.searchsorted(tasks[row + i, :left], option))
                elif option == n_tasks + n_ugvs * n_sites:
                    to = most_m + most_g * most_s
                else:
                    g, p = divmod(option - n_tasks, n_sites)
                    to = most_m + g * most_s + p
                made.option[row + i, column] = to
        row += n
    return Pool(
        made.task[:row], made.site[:row], made.uav[:row], made.ugv[:row], made.pair[:row], made.drive[:row],
        made.counts[:row], made.option[:row],
    )  # fmt: skip


MIXED = 8  # batches whose decisions are mixed with one another


def _together(examples: Sequence[Example], size: int) -> int:
    """Plans that are replayed at once."""
    mean = sum(e.steps for e in examples) / len(examples)
    return max(1, min(len(examples), round(MIXED * size / max(1.0, mean))))


def steps_of(examples: Sequence[Example], size: int) -> int:
    """How many batches one pass makes, give or take a few."""
    together = _together(examples, size)
    mean = sum(e.steps for e in examples) / len(examples)
    groups, rest = divmod(len(examples), together)
    each = max(1, round(together * mean / size))
    return groups * each + (max(1, round(rest * mean / size)) if rest else 0)


def batches(
    examples: Sequence[Example], size: int, rng: np.random.Generator, *, augment: bool = True, parts: int = 1
) -> Iterator[list[Pool]]:
    """One pass through ``examples`` in random order, as batches of about ``size`` decisions.

    Args:
        examples: the data.
        size: decisions in a batch.
        rng: for the order and the symmetries.
        augment: whether each plan is turned and mirrored at random, and UAVs that are alike are ordered at random.
        parts: each batch comes in so many, each of graphs of about one size: next to nothing of them is padding.
    """
    order = rng.permutation(len(examples))
    together = _together(examples, size)
    for first in range(0, len(order), together):
        chosen = [examples[i] for i in order[first : first + together].tolist()]
        turns, angles = [0] * len(chosen), [0.0] * len(chosen)
        if augment:
            turns = rng.integers(0, 8, len(chosen)).tolist()
            angles = rng.uniform(0.0, 2.0 * np.pi, len(chosen)).tolist()
        some = pool(chosen, turns, angles)
        rows = rng.permutation(len(some.option)).astype(np.int32)
        count = max(1, round(len(rows) / size))
        if parts == 1:
            pieces = [np.sort(part) for part in np.array_split(rows, count)]
        else:
            nodes = some.counts[rows, :4].sum(axis=1)
            pieces = np.array_split(rows[np.argsort(nodes, kind="stable")], count * parts)
        mixed = rng.permutation(len(pieces)).reshape(count, -1)
        for batch in mixed.tolist():
            yield [some.take(pieces[k]) for k in batch if len(pieces[k])]
