"""The identity check with a scripted operator: who moves what, which body follows, what comes out."""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import pytest

from drivers.errors import DriverError
from drivers.mocap_identity import Identity, IdentityCheck, IdentityOptions, identify
from drivers.vehicle import Pose, Vec3

WANTED = {"cf1": "u1", "cf2": "u2", "limo1": "g1"}
PLACES: dict[str, Vec3] = {"u1": (0.0, 0.0, 0.0), "u2": (1.0, 0.0, 0.0), "g1": (0.0, 2.0, 0.0)}


@dataclass
class Stage:
    """A clock, a pose source and an operator in one: the operator does what he is told, after a moment."""

    follows: dict[str, tuple[str, ...]]  # which bodies move when the operator moves a vehicle
    places: dict[str, Vec3] = field(default_factory=lambda: dict(PLACES))
    noise_m: float = 0.002
    hidden: Callable[[str, float], bool] = lambda _body, _t: False
    lift_m: float = 0.25
    ramp_s: float = 0.6
    dropped: dict[str, Vec3] = field(
        default_factory=dict
    )  # where a vehicle's bodies are put down, if not where they were
    said: list[str] = field(default_factory=list)
    time_s: float = 100.0
    held: str | None = None
    lift_at_s: float = 0.0
    drop_at_s: float = 0.0

    def __post_init__(self) -> None:
        self.rng = random.Random(3)

    # --- clock
    def now(self) -> float:
        return self.time_s

    def wait_until(self, time_s: float) -> float:
        self.time_s = time_s
        return time_s

    # --- operator
    def say(self, text: str) -> None:
        self.said.append(text)
        told = re.search(r"lift or push (\S+)", text)
        if told:
            self.held, self.lift_at_s, self.drop_at_s = told[1], self.time_s + 1.0, self.time_s + 4.0

    # --- pose source
    def connect(self, deadline_s: float) -> None: ...

    def close(self) -> None: ...

    def read(self) -> Sequence[Pose]:
        t = self.time_s
        part = 0.0 if self.held is None else min((t - self.lift_at_s) / self.ramp_s, (self.drop_at_s - t) / self.ramp_s)
        part = min(1.0, max(0.0, part))
        if self.held in self.dropped and t > self.lift_at_s + 1.5:
            for body in self.follows[self.held]:
                self.places[body] = self.dropped[self.held]
        poses = []
        for body, (x, y, z) in self.places.items():
            if self.hidden(body, self.time_s):
                continue
            up_m = part * self.lift_m if body in self.follows.get(self.held or "", ()) else 0.0
            noise = [self.rng.gauss(0.0, self.noise_m) for _ in range(3)]
            poses.append(Pose(body, (x + noise[0], y + noise[1], z + up_m + noise[2]), 0.0, self.time_s))
        return poses

    def run(self, wanted: dict[str, str] | None = None, options: IdentityOptions | None = None) -> dict[str, Identity]:
        results = identify(self, wanted or WANTED, self, self.say, options)
        return {result.vehicle: result for result in results}


RIGHT: dict[str, tuple[str, ...]] = {"cf1": ("u1",), "cf2": ("u2",), "limo1": ("g1",)}


def test_everybody_is_who_he_is_said_to_be() -> None:
    stage = Stage(RIGHT)
    results = stage.run()
    assert [(v, r.verdict) for v, r in results.items()] == [("cf1", "pass"), ("cf2", "pass"), ("limo1", "pass")]
    assert [text for text in stage.said if "lift" in text] == [
        f"{n} of 3: lift or push {v} by about 20 cm and hold it there; touch nothing else"
        for n, v in enumerate(WANTED, 1)
    ]
    assert stage.said.count("put cf1 down again") == 1
    assert all(r.check().verdict == "pass" for r in results.values())


@pytest.mark.parametrize("ramp_s", [0.05, 0.3, 1.4])
def test_quick_and_slow_hands(ramp_s: float) -> None:
    assert {r.verdict for r in Stage(RIGHT, ramp_s=ramp_s).run().values()} == {"pass"}


def test_a_uav_may_be_put_down_elsewhere() -> None:
    stage = Stage(RIGHT, places={**PLACES, "u1": (0.1, 2.0, 0.3)}, dropped={"cf1": (2.0, 1.0, 0.0)})
    assert {r.verdict for r in stage.run().values()} == {"pass"}


def test_a_pushed_rover_may_stay_where_it_is() -> None:
    stage = Stage(RIGHT, dropped={"limo1": (0.5, 2.0, 0.0)}, lift_m=0.25)
    assert {r.verdict for r in stage.run({"limo1": "g1", "cf1": "u1"}).values()} == {"pass"}


@pytest.mark.parametrize("noise_m", [0.0, 0.001, 0.01])
def test_noise_moves_nobody(noise_m: float) -> None:
    assert {r.verdict for r in Stage(RIGHT, noise_m=noise_m).run().values()} == {"pass"}


def test_exchanged_names_are_found_for_both() -> None:
    results = Stage({**RIGHT, "cf1": ("u2",), "cf2": ("u1",)}).run()
    assert [(r.verdict, r.moved) for r in results.values()] == [("swapped", "u2"), ("swapped", "u1"), ("pass", None)]
    assert results["cf1"].text == (
        "cf1 was moved and body 'u2' moved, which should be cf2: exchange the names in motion capture, or body in the"
        " mission"
    )
    assert results["cf1"].check().verdict == "fail"


def test_a_stranger_that_moves_is_named() -> None:
    stage = Stage({**RIGHT, "cf1": ("x9",)}, places={**PLACES, "x9": (3.0, 3.0, 0.0)})
    result = stage.run()["cf1"]
    assert (result.verdict, result.moved) == ("swapped", "x9")
    assert "not of this mission" in result.text


def test_a_ugv_carries_the_uavs_that_stand_on_it() -> None:
    stage = Stage({**RIGHT, "limo1": ("g1", "u1")}, places={**PLACES, "u1": (0.1, 2.0, 0.3)})
    assert {r.verdict for r in stage.run().values()} == {"pass"}


def test_a_ugv_whose_name_is_exchanged_with_a_uavs_is_found_though_it_carries_another() -> None:
    stage = Stage({"cf1": ("g1",), "cf2": ("u2",), "limo1": ("u1", "u2")}, places={**PLACES, "u2": (0.1, 0.0, 0.3)})
    results = stage.run()
    assert [(r.verdict, r.moved) for r in results.values()] == [("swapped", "g1"), ("pass", None), ("swapped", "u1")]


def test_two_that_move_apart_from_each_other_are_unclear() -> None:
    results = Stage({**RIGHT, "cf1": ("u1", "u2")}).run()
    assert (results["cf1"].verdict, results["cf1"].moved) == ("unclear", "u2")
    results = Stage({**RIGHT, "cf1": ("g1", "u2")}).run()
    assert results["cf1"].verdict == "unclear"
    assert results["cf2"].verdict == "pass"


def test_what_does_not_move_times_out_and_the_next_has_its_turn() -> None:
    stage = Stage({**RIGHT, "cf1": ()})
    begun_s = stage.time_s
    results = stage.run(options=IdentityOptions(prompt_s=10.0))
    assert results["cf1"].verdict == "nothing moved"
    assert "10 s" in results["cf1"].text
    assert results["cf2"].verdict == "pass"
    assert stage.time_s - begun_s < 40


def test_a_small_shove_is_not_enough() -> None:
    results = Stage(RIGHT, lift_m=0.08).run(options=IdentityOptions(prompt_s=6.0))
    assert {r.verdict for r in results.values()} == {"nothing moved"}


def test_a_body_that_is_never_seen_fails_and_the_others_are_checked() -> None:
    stage = Stage(RIGHT, hidden=lambda body, _t: body == "u2")
    results = stage.run(options=IdentityOptions(settle_s=8.0))
    assert results["cf2"].verdict == "not seen"
    assert results["cf1"].verdict == results["limo1"].verdict == "pass"
    assert "does not see its body 'u2'" in results["cf2"].text
    assert "waiting to see u2" in stage.said


def test_a_hand_that_hides_the_markers_is_told_so() -> None:
    stage = Stage(RIGHT)
    stage.hidden = lambda body, t: body == "u1" and stage.held == "cf1" and stage.lift_at_s <= t < stage.lift_at_s + 1.5
    results = stage.run()
    assert results["cf1"].verdict == "pass"
    assert stage.said[1] == "'u1' is hidden now; if you hold cf1, let the cameras see its markers"


def test_it_waits_until_everything_stands_still() -> None:
    stage = Stage(RIGHT)
    real = stage.read

    def read() -> Sequence[Pose]:  # somebody carries u2 about for the first ten seconds
        poses = real()
        if stage.time_s < 110:
            t = stage.time_s
            poses = [Pose(p.body, (t - 100, 1.0, 1.0), 0.0, t) if p.body == "u2" else p for p in poses]
        return poses

    stage.read = read  # type: ignore[method-assign]
    assert {r.verdict for r in stage.run().values()} == {"pass"}
    assert stage.said[0] == "waiting for u2 to stand still"


def test_what_never_rests_is_unclear() -> None:
    stage = Stage(RIGHT, noise_m=0.5)
    results = stage.run(options=IdentityOptions(settle_s=5.0))
    assert {r.verdict for r in results.values()} == {"unclear"}
    assert "never stood still" in results["cf1"].text


def test_nobody_to_check_is_done_at_once() -> None:
    check = IdentityCheck({})
    assert check.step([], 0.0) == []
    assert check.done
    assert check.results == ()


@pytest.mark.parametrize("number", [1, 2, 7])
def test_any_number_of_bodies(number: int) -> None:
    wanted = {f"v{i}": f"b{i}" for i in range(number)}
    stage = Stage({f"v{i}": (f"b{i}",) for i in range(number)}, places={f"b{i}": (i, 0.0, 0.0) for i in range(number)})
    assert [r.verdict for r in stage.run(wanted).values()] == ["pass"] * number


@pytest.mark.parametrize("bad", [{"moved_m": 0.0}, {"prompt_s": float("nan")}, {"still_m": 0.2}])
def test_options_check_themselves(bad: dict[str, float]) -> None:
    with pytest.raises(DriverError, match="identity check"):
        IdentityOptions(**bad)
