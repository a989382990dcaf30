"""The recording: complete for replay, useful in Foxglove, readable after a crash."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import fabricated_run
import pytest
from mcap.reader import make_reader

from deploy.errors import DeployError, InputError
from deploy.events import Action as Response
from deploy.events import Event, EventKind, Severity
from deploy.frames import Frame
from deploy.observation import Observation
from deploy.recording import FILE, LOG, Recorder, log_line, read
from deploy.recording_meta import RunMeta, versions

WELL_KNOWN = {
    "/tf": "foxglove.FrameTransforms",
    "/pose/uav0": "foxglove.PoseInFrame",
    "/pose/ugv1": "foxglove.PoseInFrame",
    "/scene/map": "foxglove.SceneUpdate",
    "/scene/tasks": "foxglove.SceneUpdate",
    "/scene/vehicles": "foxglove.SceneUpdate",
    "/scene/plan": "foxglove.SceneUpdate",
    "/scene/trails": "foxglove.SceneUpdate",
    "/log": "foxglove.Log",
    "/copcs/observation": "copcs.Observation",
    "/copcs/commands": "copcs.Commands",
    "/copcs/events": "copcs.Event",
    "/copcs/status": "copcs.Status",
    "/copcs/plan": "copcs.Plan",
    "/copcs/plan_request": "copcs.PlanRequest",
    "/copcs/mission": "copcs.Mission",
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    settings = fabricated_run.settings()
    recorder = Recorder(folder, fabricated_run.meta(), settings, fabricated_run.drawing())
    seen = []
    record = recorder.tick

    def tick(observation, **rest):
        seen.append((observation, rest))
        record(observation, **rest)

    recorder.tick = tick
    fabricated_run.write(recorder, settings, dt=5.0)
    recorder.close()
    recorder.close()
    return folder, seen


def test_every_turn_comes_back_exactly(run):
    folder, seen = run
    recording = read(folder)
    assert not recording.truncated
    ticks = list(recording.ticks())
    assert len(ticks) == len(seen)
    for tick, (observation, rest) in zip(ticks, seen, strict=True):
        assert tick.observation == observation
        for key in ("emitted", "accepted", "sent", "refusals", "events"):
            assert getattr(tick, key) == tuple(rest[key])
        request = rest["plan_request"]
        assert (tick.plan_request is None) == (request is None)
        if request is not None:
            assert tick.plan_request.problem.digest == request.problem.digest


def test_parts_come_back_alone(run):
    folder, seen = run
    recording = read(folder / FILE)
    assert recording.meta == fabricated_run.meta()
    assert recording.problem.digest == fabricated_run.problem().digest
    assert list(recording.statuses())[-1] == seen[-1][1]["status"]
    assert list(recording.events()) == [e for _, rest in seen for e in rest["events"]]
    assert list(recording.moments()) == [(o.now_s, o.late_s) for o, _ in seen]
    first, second = recording.plans()
    assert first.plan == fabricated_run.plan(fabricated_run.FIRST)
    assert (second.reason, second.zero_s) == ("ugv1 is late", 0.0)


def test_foxglove_finds_its_schemas(run):
    with (run[0] / FILE).open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        found = {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()}
        assert found.items() >= WELL_KNOWN.items()
        counts = {c.topic: summary.statistics.channel_message_counts.get(c.id, 0) for c in summary.channels.values()}
        assert all(counts[topic] for topic in WELL_KNOWN), counts
        assert counts["/log"] == counts["/copcs/events"]
        times = [m.log_time for _, _, m in reader.iter_messages(["/copcs/observation"])]
    assert times[0] == 1_700_000_000_000_000_000
    assert times[1] - times[0] == 5_000_000_000


def test_the_log_has_a_line_for_each_event(run):
    lines = (run[0] / LOG).read_text(encoding="utf-8").splitlines()
    assert len(lines) == sum(len(rest["events"]) for _, rest in run[1])
    event = Event(12.34, EventKind.POSE_STALE, Severity.WARNING, "uav0", Response.LAND_HERE, "too old")
    assert log_line(event).split() == ["12.340", "WARNING", "uav0", "pose_stale", "too", "old", "[land", "here]"]


def test_an_arena_run_is_drawn_in_its_frame(tmp_path):
    settings = fabricated_run.settings(Frame(scale=4e-4, rotation_rad=0.5, origin_m=(-2.0, -2.0), time_scale=0.02))
    with Recorder(tmp_path / "run", fabricated_run.meta(), settings, fabricated_run.drawing()) as recorder:
        fabricated_run.write(recorder, settings, dt=1.0, stop_s=1500)
    ticks = list(read(tmp_path / "run").ticks())
    assert max(abs(p.position_m[0]) for t in ticks for p in t.observation.poses) < 8


def test_a_folder_is_recorded_into_once(run, tmp_path):
    with pytest.raises(InputError, match="already is a recording"):
        Recorder(run[0], fabricated_run.meta(), fabricated_run.settings())
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="--out"):
        Recorder(tmp_path / "file", fabricated_run.meta(), fabricated_run.settings())


def test_after_closing_nothing_is_written(tmp_path):
    recorder = Recorder(tmp_path, fabricated_run.meta(), fabricated_run.settings())
    recorder.close()
    size = (tmp_path / FILE).stat().st_size
    recorder.tick(Observation(1.0))
    recorder.plan(fabricated_run.plan(fabricated_run.FIRST), 0.0, "late")
    assert (tmp_path / FILE).stat().st_size == size
    assert list(read(tmp_path).ticks()) == []


FULL = """
import resource, sys
sys.path[:0] = {path!r}
from pathlib import Path
import fabricated_run
from deploy import recording
from deploy.errors import DeployError
recording.FLUSH_BYTES = 20_000
resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))
settings = fabricated_run.settings()
recorder = recording.Recorder(Path({folder!r}), fabricated_run.meta(), settings)
try:
    fabricated_run.write(recorder, settings)
except DeployError as error:
    print(error)
fabricated_run.write(recorder, settings, stop_s=20)
recorder.close()
"""


@pytest.mark.parametrize("limit", [60_000, 500])
def test_a_full_disk_is_said_once_and_costs_only_what_came_after(tmp_path, limit):
    root = Path(__file__).resolve().parents[2]
    path = [str(root), str(Path(__file__).parent)]
    child = subprocess.run(
        [sys.executable, "-c", FULL.format(path=path, folder=str(tmp_path), limit=limit)],
        capture_output=True,
        text=True,
        check=False,
    )
    if limit == 500:  # not even its head fits
        assert "DeployError" in child.stderr
        return
    assert child.returncode == 0, child.stderr
    (line,) = child.stdout.splitlines()
    assert "recording.mcap: cannot write the recording" in line
    assert line.endswith("free some disk space")
    recording = read(tmp_path)
    assert recording.truncated
    assert len(list(recording.ticks())) > 20


def test_a_log_that_cannot_be_written_and_an_end_that_cannot(tmp_path):
    class Full:
        def write(self, line):
            raise OSError("no space left")

        def close(self):
            raise OSError("no space left")

    event = Event(0.0, EventKind.POSE_STALE, Severity.WARNING, "uav0", Response.WARN, "old")
    recorder = Recorder(tmp_path / "a", fabricated_run.meta(), fabricated_run.settings())
    recorder._log = Full()
    with pytest.raises(DeployError, match="free some disk space"):
        recorder.tick(Observation(0.0), events=[event])
    recorder.close()
    recorder = Recorder(tmp_path / "b", fabricated_run.meta(), fabricated_run.settings())
    recorder._log = Full()
    with pytest.raises(DeployError, match="free some disk space"):
        recorder.close()
    recorder.close()


CHILD = """
import sys, time
sys.path[:0] = {path!r}
from pathlib import Path
import fabricated_run
from deploy import recording
from deploy.observation import Observation
recording.FLUSH_S = 0.02
recorder = recording.Recorder(Path({folder!r}), fabricated_run.meta(), fabricated_run.settings())
n = 0
while True:
    recorder.tick(Observation(n / 50))
    n += 1
    if n == 200:
        print("going", flush=True)
    time.sleep(0.0005)
"""


def test_a_killed_process_leaves_a_readable_file(tmp_path):
    root = Path(__file__).resolve().parents[2]
    path = [str(root), str(Path(__file__).parent)]
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD.format(path=path, folder=str(tmp_path))], stdout=subprocess.PIPE, text=True
    )
    try:
        assert child.stdout.readline() == "going\n"
        time.sleep(0.05)
    finally:
        os.kill(child.pid, signal.SIGKILL)
        child.communicate()
    recording = read(tmp_path)
    assert recording.truncated
    times = [tick.observation.now_s for tick in recording.ticks()]
    assert len(times) > 100
    assert times == [i / 50 for i in range(len(times))]


def test_a_truncated_file_is_read_as_far_as_it_goes(run, tmp_path, monkeypatch):
    monkeypatch.setattr("deploy.recording.FLUSH_BYTES", 20_000)
    settings = fabricated_run.settings()
    with Recorder(tmp_path / "whole", fabricated_run.meta(), settings) as recorder:
        total = fabricated_run.write(recorder, settings, dt=5.0)
    data = (tmp_path / "whole" / FILE).read_bytes()
    lengths = []
    for share in (0.999, 0.7, 0.3):
        cut = tmp_path / f"{share}.mcap"
        cut.write_bytes(data[: int(len(data) * share)])
        recording = read(cut)
        assert recording.truncated
        lengths.append(len(list(recording.ticks())))
    assert total >= lengths[0] > lengths[1] > lengths[2] > 0
    flipped = bytearray(data)
    flipped[len(data) // 2] ^= 0xFF
    (tmp_path / "flipped.mcap").write_bytes(flipped)
    recording = read(tmp_path / "flipped.mcap")
    assert recording.truncated
    assert 0 < len(list(recording.ticks())) < total


@pytest.mark.parametrize(
    "content", [b"", b"hello", b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" + b"\xff" * 100, b"\x89MCAP0\r\n" + bytes(99)]
)
def test_foreign_files_are_one_clear_error(tmp_path, content):
    path = tmp_path / FILE
    path.write_bytes(content)
    with pytest.raises(InputError, match="give") as caught:
        read(tmp_path)
    assert str(path) in str(caught.value)


def test_a_missing_recording_is_a_clear_error(tmp_path):
    with pytest.raises(InputError, match="no such file; give a run folder"):
        read(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        read(tmp_path / "nowhere")


def test_another_programs_mcap_is_refused(tmp_path):
    import foxglove  # noqa: PLC0415

    context = foxglove.Context()
    with foxglove.open_mcap(tmp_path / FILE, context=context):
        foxglove.Channel("/other", context=context).log({"a": 1})
    with pytest.raises(InputError, match="not a recording of copcs-deploy"):
        read(tmp_path)


def test_versions_name_program_python_and_packages():
    found = versions()
    assert {"copcs-deploy", "python", "numpy", "foxglove-sdk"} <= set(found)
    assert RunMeta("a", 1, "d").versions == found


def test_a_turn_is_cheap(tmp_path):
    """Median of the recorder's CPU time; on a busy machine mean and maximum say little."""
    settings = fabricated_run.settings()
    recorder = Recorder(tmp_path, fabricated_run.meta(), settings, fabricated_run.drawing())
    costs = []
    record = recorder.tick

    def tick(*args, **kwargs):
        start = time.thread_time()
        record(*args, **kwargs)
        costs.append(time.thread_time() - start)

    recorder.tick = tick
    fabricated_run.write(recorder, settings, dt=1.0, stop_s=1000)
    recorder.close()
    assert sorted(costs)[len(costs) // 2] < 250e-6
