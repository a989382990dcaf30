"""The code in docs/add-a-vehicle.md is sound: its driver refuses what it must, and keeps the contract over its wire."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from drivers.clock import RealClock
from drivers.errors import DriverError
from drivers.limits import PoseBook, UgvLimits
from drivers.vehicle import Vehicle

PAGE = (Path(__file__).parents[2] / "docs" / "add-a-vehicle.md").read_text(encoding="utf-8")
NAMES = ("drivers.cart", "sim_backends.wire.cart", "tests.drivers.test_contract_cart")


def _modules() -> list[ModuleType]:
    blocks = re.findall(r"`([\w/]+)\.py`:\n\n```python\n(.*?)```", PAGE, re.DOTALL)
    assert [name.replace("/", ".") for name, _ in blocks] == list(NAMES)
    found = []
    for name, (path, code) in zip(NAMES, blocks, strict=True):
        module = ModuleType(name)
        sys.modules[name] = module  # the next block imports it
        exec(compile(code, f"docs/add-a-vehicle.md ({path})", "exec"), module.__dict__)
        found.append(module)
    return found


cart, _, contract = _modules()
harness = contract.harness
TestCart = pytest.mark.wire(contract.TestCart)


def made(endpoint: str = "127.0.0.1:9", **options: Any) -> Vehicle:
    vehicle: Vehicle = cart.Cart(
        "ugv0", endpoint, body="cart0", limits=UgvLimits(1.0, 1.0), book=PoseBook(), clock=RealClock(),
        options=cart.CartOptions(**options),
    )  # fmt: skip
    return vehicle


def test_wrong_options_and_addresses_are_named() -> None:
    with pytest.raises(DriverError, match=r"low_v is -1.0; give a number above 0"):
        made(low_v=-1.0)
    with pytest.raises(DriverError, match="'cart7' is no address of a cart; give HOST:PORT"):
        made("cart7")


def test_nobody_there_is_an_error_that_leaves_nothing_behind() -> None:
    vehicle = made()
    with pytest.raises(DriverError, match=r"ugv0: no answer from 127.0.0.1:9; check its power and its address"):
        vehicle.connect(0.0)
    assert not vehicle.state().link
    vehicle.close()


def test_every_file_that_the_page_names_exists() -> None:
    root = Path(__file__).parents[2]
    named = set(re.findall(r"`((?:drivers|deploy|sim_backends|tests)/[\w/]+\.py)`", PAGE))
    assert {path for path in named if not (root / path).is_file()} == {f"{n.replace('.', '/')}.py" for n in NAMES}
