"""Labels beside points, so that they cover neither each other nor other points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from deploy.drawing import Array

# around the point, best first: right, left, above, below, then the corners
DIRECTIONS = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1))
LINES_FROM = 4.0  # z-order of paths; roads lie below and may be covered
Box = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Label:
    """``text`` belongs to the point (x, y), in data coordinates."""

    x: float
    y: float
    text: str
    size: float
    colour: str
    bold: bool = False


def place(axes: Axes, labels: Sequence[Label], busy: Array, gap_pt: float = 8.0) -> None:
    """Draws ``labels`` one after another, each where it covers least of ``busy`` points (n, 2) and of drawn lines."""
    axes.figure.canvas.draw()  # the layout must be final before data can be turned into pixels
    dots = axes.transData.transform(busy) * 72 / axes.figure.dpi
    lines = np.vstack(
        [np.zeros((0, 2)), *(_along(axes, line) for line in axes.lines if line.get_zorder() >= LINES_FROM)]
    )
    x0, y0, x1, y1 = (v * 72 / axes.figure.dpi for v in axes.bbox.extents)
    taken: list[Box] = []
    for label in labels:
        px, py = axes.transData.transform((label.x, label.y)) * 72 / axes.figure.dpi
        width, height = 0.64 * label.size * len(label.text), 1.15 * label.size

        def cost(box: Box) -> float:
            inside = sum(box[0] - 5 < x < box[2] + 5 and box[1] - 5 < y < box[3] + 5 for x, y in dots)
            over = sum(box[0] < b[2] and b[0] < box[2] and box[1] < b[3] and b[1] < box[3] for b in taken)
            out = box[0] < x0 or box[2] > x1 or box[1] < y0 or box[3] > y1
            w, s, e, n = box
            crossed = ((w < lines[:, 0]) & (lines[:, 0] < e) & (s < lines[:, 1]) & (lines[:, 1] < n)).any()
            return float(2 * inside + 3 * over + 4 * out + crossed)

        boxes = []
        for dx, dy in DIRECTIONS:
            cx, cy = px + dx * (gap_pt + width / 2), py + dy * (gap_pt + height / 2 - (2 if dx else 0))
            boxes.append((cx - width / 2, cy - height / 2, cx + width / 2, cy + height / 2))
        best = min(boxes, key=cost)
        taken.append(best)
        axes.annotate(
            label.text,
            (label.x, label.y),
            xytext=((best[0] + best[2]) / 2 - px, (best[1] + best[3]) / 2 - py),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=label.size,
            color=label.colour,
            weight="bold" if label.bold else "normal",
            zorder=9.5,
            path_effects=[withStroke(linewidth=2.2, foreground="white")],
        )


def _along(axes: Axes, line: Line2D) -> Array:
    """Points every few pt along a drawn line, (n, 2) in pt."""
    corners = axes.transData.transform(line.get_xydata()) * 72 / axes.figure.dpi
    pieces = [
        a + (b - a) * np.linspace(0, 1, max(2, int(np.hypot(*(b - a)) / 3)))[:, None] for a, b in pairwise(corners)
    ]
    return np.vstack([np.zeros((0, 2)), *pieces])
