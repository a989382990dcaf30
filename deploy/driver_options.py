"""The drivers' own options as sections of mission and fleet files; keys, defaults and limits are written over there."""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

from drivers.crazyflie_options import CrazyflieOptions
from drivers.errors import DriverError
from drivers.limo import LimoOptions
from drivers.mavlink_options import MavlinkOptions
from drivers.mocap_options import MocapOptions


def _section(options: type[Any]) -> type[Any]:
    """A subclass for files: its mistakes are ``ValueError``s, which validation turns into errors with file and key."""

    def post_init(self: Any) -> None:
        try:
            options.__post_init__(self)
        except DriverError as error:
            raise ValueError(str(error)) from None

    def json_schema(cls: type[Any], core_schema: Any, handler: Any) -> Any:
        schema = handler(core_schema)
        properties = handler.resolve_ref_schema(schema)["properties"]
        for key, text in key_texts(options).items():
            if key in properties:  # the file may have changed since it was loaded
                properties[key]["description"] = text
        return schema

    names = {
        "__post_init__": post_init,
        "__get_pydantic_json_schema__": classmethod(json_schema),
        "__doc__": (options.__doc__ or "").partition("\n")[0],
        "__module__": __name__,
        "__slots__": (),
    }
    return dataclass(frozen=True)(type(options.__name__, (options,), names))


def key_texts(options: type[Any]) -> dict[str, str]:
    """What each field of an options class means: from the docstrings below them, or from ``Attributes:``."""
    doc = inspect.cleandoc(options.__doc__ or "")
    found = {}
    for field in fields(options):
        entry = rf"^( *)(?:[\w, ]+, )?{field.name}(?:, [\w, ]+)?: (.*(?:\n\1 +\S.*)*)"
        match = re.search(entry, doc, re.MULTILINE)
        if match is not None:
            found[field.name] = " ".join(match[2].split())
    try:
        body = ast.parse(textwrap.dedent(inspect.getsource(options))).body[0]
    except (OSError, SyntaxError):  # texts are for people; nothing depends on them
        return found
    assert isinstance(body, ast.ClassDef)
    for statement, below in zip(body.body, body.body[1:], strict=False):
        if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name):  # noqa: SIM102
            if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
                found[statement.target.id] = " ".join(str(below.value.value).split())
    return {key: text[:1].upper() + text[1:] for key, text in found.items()}


if TYPE_CHECKING:
    CrazyflieSection = CrazyflieOptions
    LimoSection = LimoOptions
    MavlinkSection = MavlinkOptions
    MocapSection = MocapOptions
else:
    CrazyflieSection = _section(CrazyflieOptions)
    LimoSection = _section(LimoOptions)
    MavlinkSection = _section(MavlinkOptions)
    MocapSection = _section(MocapOptions)

DriverOptions = CrazyflieOptions | LimoOptions | MavlinkOptions
