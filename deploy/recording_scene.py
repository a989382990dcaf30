"""What Foxglove draws of a run: transforms, poses, the scene and the log, in its well-known schemas.

Each part of the scene has its own topic and every message is complete, because after a jump in time Foxglove knows
only the last message of each topic.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import foxglove
from foxglove.channels import FrameTransformsChannel, LogChannel, PoseInFrameChannel, SceneUpdateChannel
from foxglove.messages import (
    Color,
    CubePrimitive,
    CylinderPrimitive,
    FrameTransform,
    FrameTransforms,
    LinePrimitive,
    LinePrimitiveLineType,
    Log,
    LogLevel,
    Point3,
    Pose,
    PoseInFrame,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    SpherePrimitive,
    TextPrimitive,
    Timestamp,
    Vector3,
)

from deploy.drawing import (
    OTHER_POLYGON,
    POLYGON_COLOURS,
    ROAD_COLOUR,
    Array,
    MapDrawing,
    planned_paths,
    vehicle_colours,
)
from deploy.events import Event, Severity
from deploy.observation import Observation
from deploy.settings import Settings
from deploy.status import Status
from drivers.vehicle import Vec3
from planner.plan import Plan
from planner.problem import Problem

FRAME = "arena"
POSE_S = 0.05  # loop time between poses of one vehicle: 20 Hz is smooth, and exact poses are in /copcs/observation
TRAIL_POINTS = 200  # a longer trail is thinned out by half
LEVELS = {
    Severity.INFO: LogLevel.Info,
    Severity.WARNING: LogLevel.Warning,
    Severity.ERROR: LogLevel.Error,
    Severity.CRITICAL: LogLevel.Fatal,
}


@dataclass
class _Trail:
    """Where a vehicle has been; ``step_m`` apart, which doubles when there are too many points."""

    colour: Color
    step_m: float
    points: list[Point3] = field(default_factory=list)
    last: Vec3 | None = None
    fresh: int = 0

    def add(self, position: Vec3) -> None:
        if self.last is not None and math.dist(self.last, position) < self.step_m:
            return
        self.last = position
        self.points.append(_point(position))
        self.fresh += 1
        if len(self.points) > TRAIL_POINTS:
            self.points, self.step_m = self.points[::2], self.step_m * 2


class SceneWriter:
    """Writes the Foxglove channels of one run; ``ns`` is always the log time."""

    def __init__(self, context: foxglove.Context, settings: Settings, drawing: MapDrawing | None) -> None:
        self._settings, self._drawing = settings, drawing
        corners = settings.geofence.polygon_m
        span = max(max(c[axis] for c in corners) - min(c[axis] for c in corners) for axis in (0, 1)) if corners else 1.0
        self._unit = span / 100  # sizes of things follow the arena: 4 m or 10 km
        self._colours = {v: _colour(c) for v, c in vehicle_colours(settings.problem).items()}
        self._vehicle_of = {u.body: u.id for u in settings.uavs} | {g.body: g.id for g in settings.ugvs}
        self._trails = {v: _Trail(self._colours[v], self._unit / 2) for v in self._vehicle_of.values()}
        self._due_s = dict.fromkeys(self._vehicle_of, -math.inf)
        self._visited: tuple[bool, ...] = tuple(bool(v) for v in settings.problem.visited)
        self._tf = FrameTransformsChannel("/tf", context=context)
        self._log = LogChannel("/log", context=context)
        self._poses = {
            body: PoseInFrameChannel(f"/pose/{vehicle}", context=context) for body, vehicle in self._vehicle_of.items()
        }
        parts = ("map", "tasks", "vehicles", "plan", "trails")
        self._parts = {part: SceneUpdateChannel(f"/scene/{part}", context=context) for part in parts}

    def start(self, ns: int) -> None:
        """Draws everything that is known before the start."""
        self._draw_map(ns)
        self._draw_tasks(ns)
        self._draw_vehicles(ns)

    def log(self, event: Event, ns: int) -> None:
        """An event as a line of the log panel."""
        text = f"{event.kind.value}: {event.text}"
        stamp = _stamp(ns)
        self._log.log(
            Log(timestamp=stamp, level=LEVELS[event.severity], message=text, name=event.vehicle or "mission"),
            log_time=ns,
        )

    def tick(self, observation: Observation, status: Status | None, ns: int) -> None:
        """Poses that are due, and tasks and trails where they have changed."""
        transforms = []
        now_s = observation.now_s
        for pose in observation.poses:
            if self._due_s.get(pose.body, math.inf) > now_s:
                continue  # not due, or nobody of ours
            self._due_s[pose.body] = now_s + POSE_S * 0.999
            x, y, z = pose.position_m
            vehicle = self._vehicle_of[pose.body]
            stamp, place = _stamp(ns), Vector3(x=x, y=y, z=z)
            turn = Quaternion(x=0.0, y=0.0, z=math.sin(pose.yaw_rad / 2), w=math.cos(pose.yaw_rad / 2))
            transforms.append(
                FrameTransform(
                    timestamp=stamp, parent_frame_id=FRAME, child_frame_id=vehicle, translation=place, rotation=turn
                )
            )
            self._poses[pose.body].log(
                PoseInFrame(timestamp=stamp, frame_id=FRAME, pose=Pose(position=place, orientation=turn)), log_time=ns
            )
        if transforms:
            self._tf.log(FrameTransforms(transforms=transforms), log_time=ns)
        if status is not None:
            if status.tasks_visited != self._visited:
                self._visited = status.tasks_visited
                self._draw_tasks(ns)
            for row in status.vehicles:
                if row.position_m is not None and row.vehicle in self._trails:
                    self._trails[row.vehicle].add(row.position_m)
            if sum(trail.fresh for trail in self._trails.values()) >= 10 * len(self._trails):
                self._draw_trails(ns)

    def plan(self, plan: Plan, problem: Problem | None, ns: int) -> None:
        """Draws a plan in place of the one before."""
        paths, recharges = planned_paths(problem or self._settings.problem, plan, self._settings.roads)
        entities = []
        altitude = {u.id: u.altitude_m for u in self._settings.uavs}
        for path in paths:
            lines = []
            if len(path.points_m):
                line = self._line(path.points_m, altitude.get(path.vehicle, 0.0), self._colours[path.vehicle], 1.5)
                lines.append(line)
            entities.append(self._entity(f"plan/{path.vehicle}", ns, lines=lines))
        labels = []
        for i, recharge in enumerate(recharges):
            x, y = self._settings.frame.to_arena(recharge.position_m)
            text = f"{recharge.uav} at {recharge.ugv}"
            labels.append(self._text((x, y, (2.5 + 1.5 * (i % 4)) * self._unit), text, self._colours[recharge.ugv]))
        entities.append(self._entity("plan/recharges", ns, texts=labels))
        self._send("plan", entities, ns)

    def _draw_map(self, ns: int) -> None:
        problem, drawing = self._settings.problem, self._drawing
        fence = [_point((x, y, 0.0)) for x, y in self._settings.geofence.polygon_m]
        loop = LinePrimitive(
            type=LinePrimitiveLineType.LineLoop,
            points=fence,
            thickness=2.0,
            scale_invariant=True,
            color=_colour("#CC3311"),
        )
        entities = [self._entity("geofence", ns, lines=[loop])]
        if drawing is not None:
            roads = [self._line(line, 0.0, _colour(ROAD_COLOUR), 3.0) for line in drawing.lines]
            entities.append(self._entity("roads", ns, lines=roads))
            for kind, rings in drawing.polygons.items():
                colour = _colour(POLYGON_COLOURS.get(kind, OTHER_POLYGON))
                entities.append(self._entity(kind, ns, lines=[self._line(r, 0.0, colour, 2.0) for r in rings]))
        spots, names = [], []
        for i, site in enumerate(problem.sites):
            x, y = self._settings.frame.to_arena((float(site[0]), float(site[1])))
            depot = i == problem.depot_index
            size = Vector3(x=self._unit, y=self._unit, z=self._unit / 4)
            spots.append(
                CylinderPrimitive(
                    pose=_pose(x, y, 0.0),
                    size=size,
                    bottom_scale=1.0,
                    top_scale=1.0,
                    color=_colour("#222222" if depot else "#777777"),
                )
            )
            names.append(self._text((x, y, self._unit), "depot" if depot else f"P{i}", _colour("#444444")))
        self._send("map", [*entities, self._entity("sites", ns, cylinders=spots, texts=names)], ns)

    def _draw_tasks(self, ns: int) -> None:
        balls, names = [], []
        for i, task in enumerate(self._settings.problem.tasks):
            x, y = self._settings.frame.to_arena((float(task[0]), float(task[1])))
            done = i < len(self._visited) and self._visited[i]
            colour = _colour("#999999" if done else "#D62828")
            size = Vector3(x=self._unit, y=self._unit, z=self._unit)
            balls.append(SpherePrimitive(pose=_pose(x, y, 0.0), size=size, color=colour))
            names.append(self._text((x, y, 1.2 * self._unit), f"{i} ✓" if done else str(i), colour))
        self._send("tasks", [self._entity("tasks", ns, spheres=balls, texts=names)], ns)

    def _draw_vehicles(self, ns: int) -> None:
        u = self._unit
        entities = []
        for row in self._settings.uavs:
            body = CylinderPrimitive(
                pose=_pose(0.0, 0.0, 0.0),
                size=Vector3(x=1.6 * u, y=1.6 * u, z=0.4 * u),
                bottom_scale=1.0,
                top_scale=0.6,
                color=self._colours[row.id],
            )
            label = self._text((0.0, 0.0, 1.2 * u), row.id, self._colours[row.id])
            entities.append(self._entity(f"vehicle/{row.id}", ns, row.id, cylinders=[body], texts=[label]))
        for ugv in self._settings.ugvs:
            box = CubePrimitive(
                pose=_pose(0.0, 0.0, 0.3 * u), size=Vector3(x=2 * u, y=1.4 * u, z=0.6 * u), color=self._colours[ugv.id]
            )
            label = self._text((0.0, 0.0, 1.6 * u), ugv.id, self._colours[ugv.id])
            entities.append(self._entity(f"vehicle/{ugv.id}", ns, ugv.id, cubes=[box], texts=[label]))
        self._send("vehicles", entities, ns)

    def _draw_trails(self, ns: int) -> None:
        entities = []
        for vehicle, trail in self._trails.items():
            trail.fresh = 0
            line = LinePrimitive(points=trail.points, thickness=3.0, scale_invariant=True, color=trail.colour)
            entities.append(self._entity(f"trail/{vehicle}", ns, lines=[line]))
        self._send("trails", entities, ns)

    def _send(self, part: str, entities: Sequence[SceneEntity], ns: int) -> None:
        self._parts[part].log(SceneUpdate(entities=list(entities)), log_time=ns)

    def _entity(  # one keyword per primitive, as in Foxglove
        self,
        name: str,
        ns: int,
        frame: str = FRAME,
        *,
        lines: Iterable[LinePrimitive] = (),
        texts: Iterable[TextPrimitive] = (),
        spheres: Iterable[SpherePrimitive] = (),
        cylinders: Iterable[CylinderPrimitive] = (),
        cubes: Iterable[CubePrimitive] = (),
    ) -> SceneEntity:
        return SceneEntity(
            timestamp=_stamp(ns),
            frame_id=frame,
            id=name,
            frame_locked=True,
            lines=list(lines),
            texts=list(texts),
            spheres=list(spheres),
            cylinders=list(cylinders),
            cubes=list(cubes),
        )

    def _line(self, world_m: Array, z: float, colour: Color, thickness: float) -> LinePrimitive:
        to_arena = self._settings.frame.to_arena
        points = [_point((*to_arena((float(x), float(y))), z)) for x, y in world_m]
        return LinePrimitive(points=points, thickness=thickness, scale_invariant=True, color=colour)

    def _text(self, at: Vec3, text: str, colour: Color) -> TextPrimitive:
        return TextPrimitive(pose=_pose(*at), billboard=True, font_size=1.2 * self._unit, color=colour, text=text)


def _stamp(ns: int) -> Timestamp:
    return Timestamp(*divmod(ns, 1_000_000_000))


def _point(position: Vec3) -> Point3:
    return Point3(x=position[0], y=position[1], z=position[2])


def _pose(x: float, y: float, z: float) -> Pose:
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))


def _colour(text: str) -> Color:
    r, g, b = (int(text[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return Color(r=r, g=g, b=b, a=1.0)
