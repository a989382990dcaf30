"""Draws how a lab is wired, for the pages on preparing vehicles: python -m benchmarks.draw_lab [FILE]."""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch, Rectangle

INK, PALE, CABLE, AIR = "#1f2937", "#6b7280", "#374151", "#0e7490"
BOX = {"air": "#fdf0d5", "ground": "#dcecdf", "computer": "#dde6f3", "network": "#ececec", "eye": "#f3e1ee"}
Place = tuple[float, float]


def box(axes: Axes, at: Place, size: Place, kind: str, title: str, *lines: str) -> None:
    """A device around its middle."""
    (x, y), (w, h) = at, size
    style = "round,pad=0,rounding_size=0.12"
    axes.add_patch(
        FancyBboxPatch(
            (x - w / 2, y - h / 2), w, h, boxstyle=style, facecolor=BOX[kind], edgecolor=INK, lw=1.1, zorder=3
        )
    )
    top = y + 0.12 * len(lines)
    axes.text(x, top, title, ha="center", va="center", fontsize=10.5, weight="bold", color=INK, zorder=4)
    for i, line in enumerate(lines):
        axes.text(x, top - 0.25 * (i + 1), line, ha="center", va="center", fontsize=8.4, color=INK, zorder=4)


def wire(axes: Axes, *places: Place, radio: bool = False) -> None:
    """A cable along some places; dashed where it is a radio."""
    colour, dash = (AIR, (0, (4, 2.5))) if radio else (CABLE, "-")
    axes.plot(*zip(*places, strict=True), color=colour, linestyle=dash, lw=1.7, zorder=1, solid_capstyle="round")


def note(axes: Axes, at: Place, text: str, *, radio: bool = False, ha: str = "center") -> None:
    """What a connection carries."""
    colour = AIR if radio else CABLE
    pad = {"boxstyle": "square,pad=0.15", "facecolor": "white", "edgecolor": "none"}
    axes.text(*at, text, ha=ha, va="center", fontsize=8.4, color=colour, zorder=2, linespacing=1.25, bbox=pad)


def arena(axes: Axes) -> None:
    """The vehicles and the cameras around them."""
    axes.add_patch(Rectangle((0.2, 5.4), 11.6, 2.5, facecolor="#fafaf7", edgecolor=PALE, lw=1, linestyle=":", zorder=0))
    axes.text(0.4, 7.68, "arena, in a net; geofence inside it", fontsize=9, color=PALE, va="center")
    for x, n in ((1.75, 1), (4.15, 2)):
        box(axes, (x, 6.2), (2.15, 1.15), "air", f"Crazyflie cf{n}", "markers, charging coil", f"address E7E7E7E70{n}")
    for x, n in ((6.55, 1), (8.95, 2)):
        box(
            axes, (x, 6.2), (2.15, 1.15), "ground", f"Limo limo{n}", "pad on its roof, markers", f"ROS names /limo{n}/…"
        )
    for x in (1.75, 4.15, 6.55, 8.95):
        axes.plot([x, x], [7.35, 7.15], color=CABLE, lw=1.7, zorder=1)
        axes.plot([x], [7.15], marker="v", markersize=11, color=BOX["eye"], markeredgecolor=INK, zorder=3)
    axes.text(10.3, 7.13, "cameras", fontsize=9, color=INK, ha="center", va="center")
    wire(axes, (1.75, 7.35), (11.55, 7.35), (11.55, 2.45), (9.6, 2.45))


def computers(axes: Axes) -> None:
    """Everything outside, and what connects it."""
    box(axes, (2.95, 4.05), (1.9, 0.75), "network", "Crazyradio", "channel 80, 2M")
    box(axes, (7.75, 4.05), (2.3, 0.75), "network", "Wi-Fi access point", "multicast let through")
    box(axes, (7.75, 2.45), (3.7, 0.8), "network", "switch", "one subnet, 192.168.1.0/24, wired")
    box(
        axes, (2.95, 1.2), (4.4, 1.5), "computer", "ground station 192.168.1.10",
        "copcs-deploy run lab.yaml --backend real", "cflib · rclpy, Fast DDS · motioncapture",
        "keyboard: Ctrl-C lands, twice stops motors",
    )  # fmt: skip
    box(
        axes, (9.45, 0.85), (3.6, 1.0), "eye", "Motive PC 192.168.1.20", "bodies cf1, cf2, limo1, limo2",
        "NatNet unicast, up axis z",
    )  # fmt: skip
    wire(axes, (1.75, 5.6), (2.6, 4.4), radio=True)
    wire(axes, (4.15, 5.6), (3.3, 4.4), radio=True)
    note(axes, (4.0, 4.05), "2.4 GHz radio, CRTP:\nposes and commands down,\ntelemetry up", radio=True, ha="left")
    wire(axes, (2.95, 3.68), (2.95, 1.95))
    note(axes, (2.95, 2.95), "USB; at most 4 vehicles a radio")
    wire(axes, (6.55, 5.6), (7.45, 4.4), radio=True)
    wire(axes, (8.95, 5.6), (8.05, 4.4), radio=True)
    text = "Wi-Fi, DDS over UDP,\n7400 + 250 × domain:\ncmd_vel down;\nodom, limo_status up"
    note(axes, (9.0, 4.05), text, radio=True, ha="left")
    wire(axes, (7.75, 3.68), (7.75, 2.85))
    note(axes, (7.75, 3.27), "Ethernet")
    wire(axes, (5.15, 1.45), (6.2, 1.45), (6.2, 2.1))
    note(axes, (6.3, 1.62), "Ethernet", ha="left")
    wire(axes, (9.1, 2.05), (9.1, 1.35))
    note(axes, (9.22, 1.7), "to the station: frames, UDP 1511\nfrom it: requests, UDP 1510", ha="left")
    note(axes, (11.55, 3.2), "camera\nnetwork\n(PoE)")


def main() -> None:
    parser = argparse.ArgumentParser(description="Draws how a lab is wired.")
    parser.add_argument("file", type=Path, nargs="?", default=Path("docs/lab-wiring.png"))
    file: Path = parser.parse_args().file
    mpl.use("agg")
    figure, axes = plt.subplots(figsize=(12, 8.1))
    axes.set_xlim(0, 12.1)
    axes.set_ylim(0.1, 8.1)
    axes.set_aspect("equal")
    axes.axis("off")
    arena(axes)
    computers(axes)
    figure.savefig(file, dpi=110, bbox_inches="tight", facecolor="white", metadata={"Software": None})
    print(file)


if __name__ == "__main__":
    main()
