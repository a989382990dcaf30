"""Measures the learned planner: a decision of network plus by ours, torch and ONNX Runtime; whole plans per second.

Run: python -m benchmarks.bench_policy [--weights FILE] [--threads 1] [--random]. Random weights take as long for a
decision, but their plans are bad and have more of them. ONNX Runtime is measured where it and onnx are installed,
torch.compile with --compile (it needs a C++ compiler). On a busy machine, --cpu counts the processor's time only.
"""

from __future__ import annotations

import argparse
import io
import multiprocessing
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from planner import kernel
from planner.errors import exit_on_error
from planner.instances import data_set
from planner.policy import tokens_kernel as tk
from planner.policy.blas import kernels, one_thread
from planner.policy.complete_kernel import complete
from planner.policy.config import PlusConfig
from planner.policy.decode import Policy
from planner.policy.features_kernel import fill_view
from planner.policy.plus_kernel import logits
from planner.policy.plus_net import Batch, PlusNet
from planner.policy.shipped import FOLDER, NAME
from planner.policy.state import State, new_state
from planner.policy.weights import plus_weights, read, room
from planner.problem import Problem
from planner.schedule import evaluate

CORES = 2  # that the targets are for
TARGET_HZ = {"T15-P5": 90, "T45-P10": 30}
NAMES = ("task", "site", "uav", "ugv", "pair", "drive", "counts")


def decisions(problem: Problem, policy: Policy) -> list[tuple[np.ndarray, ...]]:
    """What the network sees at each decision of its own greedy plan."""
    plan = policy.alone().greedy(problem).codes.tolist()
    s = new_state(problem)
    tk.start(s.world, s.work, s.turn)
    found = []
    while plan and s.work.sums[kernel.S_LEFT] > 0:
        u = tk.acting(s.work, s.turn)
        code = next((c for c in plan if c >> kernel.VEHICLE & kernel.MASK == u), None)
        tk.offer(s.world, s.work, s.turn, u)
        fill_view(s.world, s.work, s.turn, u, s.xy, s.reach, s.view)
        v, left, active = s.view, int(s.view.counts[0]), int(s.view.counts[2])
        found.append(tuple(x.copy() for x in (v.task[:left], v.site, v.uav[:active], v.ugv, v.pair, v.drive, v.counts)))
        if code is None:
            s.turn.done[u] = 1
        else:
            plan.remove(code)
            tk.apply(s.world, s.work, s.turn, code)
    return found


TIME = [time.perf_counter]  # the clock


def clock(run: Callable[[], Any], least_s: float = 1.0) -> float:
    """The median time of a call in s."""
    run()
    times: list[float] = []
    while sum(times) < least_s or len(times) < 5:
        begun = TIME[0]()
        run()
        times.append(TIME[0]() - begun)
    return statistics.median(times)


def flops(config: PlusConfig, seen: list[tuple[np.ndarray, ...]]) -> float:
    """Multiplications and additions of a plan's matrix products: what no implementation can do without."""
    total = 0.0
    d, f = config.dim, config.hidden
    for v in seen:
        n = len(v[0]) + len(v[1]) + len(v[2]) + len(v[3])
        total += config.layers * 2.0 * (n * (4 * d * d + 2 * d * f) + 2 * n * n * d) + 2.0 * n * d * d
    return total


def speed(d: int = 96) -> float:
    """Floating point operations per second of one product of the network's shape."""
    a, b = np.random.default_rng(0).random((2, 40, 3 * d), np.float32)
    b = np.ascontiguousarray(np.resize(b, (3 * d, 3 * d)))
    out = np.empty((40, 3 * d), np.float32)
    return 2.0 * 40 * 9 * d * d / clock(lambda: np.dot(a, b, out), 0.2)


def ours(config: PlusConfig, tensors: Any, seen: list[tuple[np.ndarray, ...]], problem: Problem) -> Callable[[], None]:
    w = plus_weights(config, tensors)
    n_tasks, n_sites, n_ugvs = problem.n_tasks, len(problem.sites), len(problem.ugvs)
    space = room(config, n_tasks + n_sites + len(problem.uavs) + n_ugvs)
    visit, meet, done = np.zeros(n_tasks, "f"), np.zeros((n_ugvs, n_sites), "f"), np.zeros(1, "f")
    view = new_state(problem).view
    views = [view._replace(**dict(zip(NAMES, v, strict=True))) for v in seen]

    def run() -> None:
        for one in views:
            logits(w, space, one, visit, meet, done)

    return run


def onnx(net: PlusNet, batches: list[Batch]) -> Callable[[], None] | None:
    """The network in ONNX Runtime; None where it is not installed."""
    try:
        import onnxruntime  # noqa: PLC0415  (optional)

        file = io.BytesIO()
        axes = {name: {i: f"{name}{i}" for i in range(1, 3)} for name in NAMES[:-1]}
        torch.onnx.export(Plain(net), tuple(batches[0]), file, input_names=list(NAMES), dynamic_axes=axes, dynamo=False,
                          opset_version=17)  # fmt: skip
    except ImportError as error:
        print(f"ONNX Runtime is not measured: {error}")
        return None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = torch.get_num_threads()
    session = onnxruntime.InferenceSession(file.getvalue(), options, providers=["CPUExecutionProvider"])
    wanted = {x.name for x in session.get_inputs()}
    feeds = [{n: x.numpy() for n, x in zip(NAMES, b, strict=True) if n in wanted} for b in batches]

    def run() -> None:
        for feed in feeds:
            session.run(None, feed)

    return run


class Plain(torch.nn.Module):
    """The network with its inputs one by one, as the exporter takes them."""

    def __init__(self, net: PlusNet) -> None:
        super().__init__()
        self.net = net

    def forward(self, *parts: torch.Tensor) -> torch.Tensor:
        """The logits."""
        out: torch.Tensor = self.net(Batch(*parts))
        return out


def plan(policy: Policy, problem: Problem) -> None:
    """From problem to schedule; nothing of the problem is known from before."""
    new = replace(problem)
    evaluate(new, policy.greedy(new).actions(new))


def rate(weights: Path, name: str, least_s: float) -> float:
    """Whole greedy plans per second of one process."""
    policy, problem = Policy.load(weights), data_set(name).instance(900)
    policy.greedy(problem)
    begun, n = time.perf_counter(), 0
    while (took := time.perf_counter() - begun) < least_s:
        plan(policy, problem)
        n += 1
    return n / took


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bench_policy")
    parser.add_argument("--weights", type=Path, default=FOLDER / NAME)
    parser.add_argument("--sets", default="T15-P5_2-1,T15-P5_4-2,T45-P10_2-1,T45-P10_4-2")
    parser.add_argument("--random", action="store_true", help="random weights instead")
    parser.add_argument("--layers", type=int, default=PlusConfig().layers, help="of the random network")
    parser.add_argument("--dim", type=int, default=PlusConfig().dim)
    parser.add_argument("--threads", type=int, default=1, help="of torch and ONNX Runtime")
    parser.add_argument("--compile", action="store_true", help="measure torch.compile as well")
    parser.add_argument("--cpu", action="store_true", help="processor time instead of time")
    given = parser.parse_args()
    if given.cpu:
        TIME[0] = time.process_time
    torch.set_num_threads(given.threads)
    torch.manual_seed(0)
    if given.random:
        net = PlusNet(PlusConfig(dim=given.dim, heads=given.dim // 16, hidden=2 * given.dim, layers=given.layers))
        config, tensors = net.config, {k: v.detach().numpy() for k, v in net.state_dict().items()}
    else:
        some, tensors, _ = read(given.weights)
        assert isinstance(some, PlusConfig)
        config = some
        net = PlusNet(config)
        net.load_state_dict({k: torch.from_numpy(v) for k, v in tensors.items()}, strict=False)
    net.eval()
    policy = Policy(config, tensors)
    one_thread()
    print(f"matrix products: {kernels()}, one thread")
    print(f"{config}, {sum(x.numel() for x in net.parameters()):,} parameters")
    for name in given.sets.split(","):
        target = TARGET_HZ[data_set(name).setup]
        problem = data_set(name).instance(900)
        seen = decisions(problem, policy)
        n = len(seen)
        batches = [Batch(*(torch.from_numpy(x[None]) for x in v)) for v in seen]

        def eager(model: Any = net, batches: list[Batch] = batches) -> None:
            with torch.inference_mode():
                for b in batches:
                    model(b)

        rows = {"ours": clock(ours(config, tensors, seen, problem)), "torch eager": clock(eager)}
        if given.compile:
            compiled = torch.compile(net, dynamic=True)
            rows["torch.compile"] = clock(lambda model=compiled, run=eager: run(model))
        session = onnx(net, batches)
        if session is not None:
            rows["ONNX Runtime"] = clock(session)
        least = flops(config, seen) / speed(config.dim)
        whole = clock(lambda problem=problem: plan(policy, problem))
        print(f"{name}: {n} decisions")
        for what, took in rows.items():
            print(f"  network, {what:14} {1e3 * took:8.2f} ms a plan, {1e6 * took / n:7.0f} us a decision")
        print(f"  network, products alone {1e3 * least:6.2f} ms a plan")
        s = new_state(problem)
        tk.start(s.world, s.work, s.turn)
        hint = np.zeros(2, np.int64)

        def finish(s: State = s, hint: np.ndarray = hint) -> None:
            s.turn.outline.node[:] = -1  # what was outlined before is forgotten
            complete(s.world, s.work, s.space, s.turn, hint, s.way)

        print(f"  looking ahead, at first {1e3 * clock(finish, 0.2):6.2f} ms a way to finish")
        print(f"  problem to schedule     {1e3 * whole:7.2f} ms, {1 / whole:6.0f} Hz on one core")
        if not given.random:
            with ProcessPoolExecutor(CORES, multiprocessing.get_context("spawn")) as pool:
                some_rates = list(pool.map(rate, [given.weights] * CORES, [name] * CORES, [3.0] * CORES))
            print(f"  {CORES} processes, one a core {sum(some_rates):14.0f} Hz in all (target {target} Hz)")


if __name__ == "__main__":
    exit_on_error(main)
