"""Pictures: they exist, are sharp enough, and their labels stay apart."""

from __future__ import annotations

from dataclasses import replace

import fabricated_run
import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from deploy.drawing import MapDrawing, planned_paths, vehicle_colours
from deploy.errors import DeployError
from deploy.labels import Label, place
from deploy.pictures import STYLE, draw_map, plan_picture, to_svg
from planner.plan import Move, Recharge
from planner.roads import RoadError


def test_plan_picture_is_large_and_not_empty(tmp_path):
    plan = fabricated_run.plan(fabricated_run.FIRST)
    path = tmp_path / "plan.png"
    plan_picture(fabricated_run.problem(), plan, path, fabricated_run.GridRoads(), fabricated_run.drawing())
    with Image.open(path) as image:
        assert min(image.size) > 1200
        assert len(np.unique(np.asarray(image.convert("RGB")).reshape(-1, 3), axis=0)) > 50


def test_plan_picture_needs_neither_roads_nor_map(tmp_path):
    plan = fabricated_run.plan(fabricated_run.FIRST)
    bad = replace(plan, schedule=replace(plan.schedule, feasible=False, violation="uav 0 is 3 kJ short"))
    plan_picture(fabricated_run.problem(), bad, tmp_path / "plan.svg")
    assert (tmp_path / "plan.svg").read_text(encoding="utf-8").startswith("<?xml")
    with pytest.raises(DeployError, match=r"give a \.png or \.svg file"):
        plan_picture(fabricated_run.problem(), plan, tmp_path / "plan.docx")


def test_planned_paths_follow_roads_and_meet_at_recharges():
    problem = fabricated_run.problem()
    plan = fabricated_run.plan((Move(0, 0), Recharge(0, 0)))
    paths, recharges = planned_paths(problem, plan, fabricated_run.GridRoads())
    drive = next(p for p in paths if p.vehicle == "ugv0")
    assert drive.points_m.tolist() == [[5000, 300], [5000, 300], [2500, 300], [2500, 3500]]
    assert recharges[0].position_m == (2500.0, 3500.0)
    assert next(p for p in paths if p.vehicle == "ugv1").points_m.shape == (0, 2)

    class NoRoads(fabricated_run.GridRoads):
        def route(self, start, site):
            raise RoadError("none")

    paths, _ = planned_paths(problem, plan, NoRoads())
    assert next(p for p in paths if p.vehicle == "ugv0").points_m.tolist() == [[5000, 300], [5000, 300], [2500, 3500]]


def test_small_maps_are_in_metres_and_show_their_image():
    axes = Figure().add_subplot()
    image = np.full((10, 20), 254, dtype=np.uint8)
    assert draw_map(axes, MapDrawing((0, 4, 0, 3), image=image)) == 1.0
    assert axes.get_xlabel() == "east, m"
    assert len(axes.images) == 1
    assert draw_map(Figure().add_subplot(), fabricated_run.drawing()) == 1000.0


def test_labels_cover_neither_each_other_nor_points():
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4, 4))
        axes = figure.add_subplot()
        axes.set_xlim(0, 1)
        axes.set_ylim(0, 1)
        points = np.array([(0.5, 0.5), (0.56, 0.5), (0.5, 0.56), (0.97, 0.5)])
        place(axes, [Label(x, y, f"P{i}", 8.0, "black") for i, (x, y) in enumerate(points)], points)
        figure.canvas.draw()
        boxes = [text.get_window_extent() for text in axes.texts]
    for i, a in enumerate(boxes):
        assert all(not a.overlaps(b) for b in boxes[:i])
        assert not any(a.contains(*axes.transData.transform(p)) for p in points)
    assert boxes[3].x1 <= axes.bbox.x1


def test_svg_refers_to_nothing_and_is_the_same_again():
    def picture():
        figure = Figure(figsize=(3, 3))
        draw_map(figure.add_subplot(), fabricated_run.drawing())
        return to_svg(figure)

    text = picture()
    assert text.startswith("<svg")
    assert "<metadata>" not in text
    assert " width=" not in text[: text.index(">")]
    assert text == picture()


def test_colours_differ_within_a_usual_team():
    colours = vehicle_colours(fabricated_run.problem())
    assert len(set(colours.values())) == 4
