"""Draws the three maps of the data sets for docs/instances.md: python -m benchmarks.draw_instances [FOLDER]."""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline

from planner.instances import MAPS, DataSet
from planner.terrain import Terrain, terrain

COLOURS = {"wood": "#cfe0c3", "field": "#e9e4c9", "water": "#a9cfe6", "block": "#d3c7b8", "building": "#9a8f86"}
TEST_INDEX = 800  # whose tasks are drawn


def draw_map(axes: Axes, land: Terrain) -> None:
    axes.set_facecolor("#f5f3ee")
    for kind, shape in land.areas:
        rings = [shape.exterior, *shape.interiors]
        outline = Outline.make_compound_path(*(Outline(np.array(ring.coords)) for ring in rings))
        axes.add_patch(PathPatch(outline, facecolor=COLOURS[kind], linewidth=0))
    width = 1.6 if len(land.roads) < 200 else 1.2
    for road in land.roads:
        axes.plot(*road.T, color="#a2988a", linewidth=width + 0.8, solid_capstyle="round")
    for road in land.roads:
        axes.plot(*road.T, color="white", linewidth=width, solid_capstyle="round")


def draw_sites(axes: Axes, name: str) -> None:
    for setup, marker, colour, size in (("T45-P10", "s", "#1b7f5c", 46), ("T15-P5", "o", "#c2410c", 92)):
        problem = DataSet(setup, (2, 2), name).instance(TEST_INDEX)
        x, y = problem.path_points.T
        face = "none" if marker == "o" else colour
        label = f"{len(problem.path_points)} path points ({setup})"
        axes.scatter(x, y, size, marker=marker, edgecolors=colour, facecolors=face, linewidths=2, zorder=5, label=label)
        if setup == "T45-P10":
            axes.scatter(*problem.tasks.T, 10, color="#1f2937", zorder=4, label=f"tasks of test instance {TEST_INDEX}")
    axes.scatter(*problem.depot, 130, marker="*", color="#7c1d6f", zorder=6, label="depot")


def main() -> None:
    parser = argparse.ArgumentParser(description="Draws the maps of the data sets.")
    parser.add_argument("folder", type=Path, nargs="?", default=Path("docs/instances"))
    folder: Path = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    mpl.use("agg")
    for name in MAPS:
        land = terrain(name)
        figure, (left, right) = plt.subplots(1, 2, figsize=(13, 6.9), layout="constrained")
        draw_map(left, land)
        draw_sites(left, name)
        left.set_title(f"{name}: {len(land.roads)} roads, {land.network.lines.shape[0]} pieces", fontsize=11)
        figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=9)
        right.imshow(land.occupancy(), origin="lower", extent=(0, land.side_m, 0, land.side_m), cmap="gray", vmin=-0.3)
        right.set_title("occupancy, 20 m cells: white is free, roads and bridges included", fontsize=11)
        for axes in (left, right):
            axes.set(xlim=(0, land.side_m), ylim=(0, land.side_m), aspect="equal")
            axes.set_xticks(range(0, 10001, 2000), [f"{t // 1000} km" for t in range(0, 10001, 2000)])
            axes.set_yticks(range(0, 10001, 2000), [f"{t // 1000}" for t in range(0, 10001, 2000)])
        figure.savefig(folder / f"{name}.png", dpi=72)
        plt.close(figure)


if __name__ == "__main__":
    main()
