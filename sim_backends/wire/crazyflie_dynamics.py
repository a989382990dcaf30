"""How a Crazyflie moves: the identified model ``so_rpy`` of the ``drone-models`` package, one step at a time.

Attitude follows its command as a fitted second-order system, thrust acts along the body's z axis. CasADi compiles a
Runge-Kutta step of it, which then costs a microsecond.
"""

from __future__ import annotations

import inspect
import os
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

MODELS = {"brushed": "cf2x_L250", "brushless": "cf21B_500"}
"""Names in ``drone_models`` by variant."""


@dataclass(frozen=True, slots=True)
class Airframe:
    """What the controller has to know of the model.

    Attributes:
        mass_kg: of the vehicle.
        thrust_n: greatest collective thrust.
        thrust_gain: thrust per commanded thrust.
        tilt_gain: commanded over resulting roll and pitch at rest.
        yaw_gain: the same for yaw.
    """

    mass_kg: float
    thrust_n: float
    thrust_gain: float
    tilt_gain: float
    yaw_gain: float


class Dynamics:
    """The state (position, roll pitch yaw, velocity, their rates) and its step."""

    def __init__(self, variant: str, step_s: float) -> None:
        """Builds the step.

        Args:
            variant: ``brushed`` or ``brushless``.
            step_s: its length.
        """
        import casadi as ca  # noqa: PLC0415

        load_params, symbolic_dynamics_euler = _model()
        params: dict[str, Any] = load_params("so_rpy", MODELS[variant])
        wanted = inspect.signature(symbolic_dynamics_euler).parameters
        x_dot, x_sym, u_sym, _ = symbolic_dynamics_euler(**{k: v for k, v in params.items() if k in wanted})
        f = ca.Function("f", [x_sym, u_sym], [x_dot]).expand()
        x, u, h = ca.SX.sym("x", 12), ca.SX.sym("u", 4), step_s
        k1 = f(x, u)
        k2 = f(x + h / 2 * k1, u)
        k3 = f(x + h / 2 * k2, u)
        k4 = f(x + h * k3, u)
        self._step = ca.Function("step", [x, u], [x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])
        self._buffer, self._run = self._step.buffer()
        self.state = array("d", bytes(12 * 8))
        self._command, self._next = array("d", bytes(4 * 8)), array("d", bytes(12 * 8))
        buffer: Any = self._buffer  # its stubs do not know that a memoryview brings its own size
        buffer.set_arg(0, memoryview(self.state))
        buffer.set_arg(1, memoryview(self._command))
        buffer.set_res(0, memoryview(self._next))
        self.airframe = Airframe(
            mass_kg=float(params["mass"]),
            thrust_n=4.0 * float(params["thrust_max"]),
            thrust_gain=float(params["cmd_f_coef"]),
            tilt_gain=-float(params["rpy_coef"][0] / params["cmd_rpy_coef"][0]),
            yaw_gain=-float(params["rpy_coef"][2] / params["cmd_rpy_coef"][2]),
        )

    def step(self, roll: float, pitch: float, yaw: float, thrust_n: float) -> None:
        """One step under commanded angles (rad) and collective thrust (N)."""
        self._command[:] = array("d", (roll, pitch, yaw, thrust_n))
        self._run()
        self.state[:] = self._next


def _model() -> tuple[Callable[..., Any], Callable[..., Any]]:
    """The two functions of ``drone_models`` that are used here.

    The package wants scipy imported after SCIPY_ARRAY_API is set, and sets it. That would change scipy for the whole
    process, and the symbolic part needs none of it: scipy comes first, and the environment is put back.
    """
    import scipy.spatial.transform  # noqa: F401, PLC0415

    before = os.environ.get("SCIPY_ARRAY_API")
    os.environ["SCIPY_ARRAY_API"] = "1"
    try:
        from drone_models.core import load_params  # noqa: PLC0415
        from drone_models.so_rpy import symbolic_dynamics_euler  # noqa: PLC0415
    finally:
        if before is None:
            del os.environ["SCIPY_ARRAY_API"]
        else:
            os.environ["SCIPY_ARRAY_API"] = before
    return load_params, symbolic_dynamics_euler
