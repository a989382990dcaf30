"""JSON schemas of the exact channels, so that Foxglove completes message paths; derived from the dataclasses."""

from __future__ import annotations

import types
from dataclasses import fields, is_dataclass
from enum import Enum, IntEnum
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

Schema = dict[str, Any]


def schema_of(title: str, kind: type[Any] | None = None) -> Schema:
    """A schema named ``title`` for the dataclass ``kind``; any object where none is given."""
    return {**({"type": "object"} if kind is None else _schema(kind)), "title": title}


def _schema(kind: Any) -> Schema:
    plain: dict[Any, Schema] = {
        float: {"type": "number"},
        int: {"type": "integer"},
        bool: {"type": "boolean"},
        str: {"type": "string"},
    }
    if kind in plain:
        return plain[kind]
    if get_origin(kind) is Literal:
        return {"type": "string"}
    if get_origin(kind) in (types.UnionType, Union):
        options = [k for k in get_args(kind) if k is not type(None)]
        # Foxglove's reader takes one plain type a field, so that unions stay open objects
        return _schema(options[0]) if len(options) == 1 else {"type": "object"}
    if get_origin(kind) is tuple:
        return {"type": "array", "items": _schema(get_args(kind)[0])}
    if isinstance(kind, type) and issubclass(kind, Enum):
        return {"type": "integer" if issubclass(kind, IntEnum) else "string"}
    if is_dataclass(kind) and isinstance(kind, type) and kind.__dataclass_params__.eq:  # type: ignore[attr-defined]
        hints = get_type_hints(kind)
        return {"type": "object", "properties": {f.name: _schema(hints[f.name]) for f in fields(kind)}}
    return {"type": "object"}
