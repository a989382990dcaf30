"""Turns pydantic's findings into one sentence that names the file, the key, the value and the remedy."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from deploy.mission_model import suggestion
from deploy.yaml_file import Document, KeyPath
from drivers.errors import DriverError

Model = TypeVar("Model", bound=BaseModel)
_UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")
_MISSING = ("missing", "missing_argument")
_TAGS = {"xy", "lonlat"}


def validate(
    model: type[Model],
    data: dict[str, Any],
    document: Document,
    origin: Callable[[KeyPath], KeyPath] = lambda key: key,
) -> Model:
    """Validates ``data``, which came from ``document``.

    Args:
        model: what it should be.
        data: plain data.
        document: for names and lines in errors.
        origin: where in the document a key of ``data`` stands.

    Raises:
        InputError: the first mistake, unknown keys before others since they cause others.
    """
    try:
        # As JSON, strict mode still takes lists for tuples and text for enumerations: the kinds YAML has.
        return model.model_validate_json(json.dumps(data))
    except ValidationError as error:
        found = error.errors(include_url=False)
    except DriverError as error:  # of something within a driver's options
        raise document.error(str(error)) from None
    except (ValueError, RecursionError, TypeError) as error:
        raise document.error(f"cannot be understood: {error}") from None
    # A misspelt key shows up twice, as unknown and as missing: the first helps.
    found.sort(key=lambda e: 0 if e["type"] in _UNKNOWN else 2 if e["type"] in _MISSING else 1)
    first = found[0]
    key = _clean(first["loc"], data)
    more = f" ({len(found) - 1} more mistakes follow)" if len(found) > 1 else ""
    raise document.error(_sentence(model, dict(first), key) + more, origin(key)) from None


def shown(value: object) -> str:
    """``value`` short enough for a sentence, as YAML writes it."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."


def _clean(location: tuple[int | str, ...], data: Any) -> KeyPath:
    """Drops what pydantic adds to a location: names of union members."""
    key: list[str | int] = []
    here = data
    for part in location:
        if isinstance(here, dict) and (part in here or part not in _TAGS):
            here = here.get(part)
        elif isinstance(here, list) and isinstance(part, int) and part < len(here):
            here = here[part]
        elif not (isinstance(here, list) and isinstance(part, int)):
            continue
        key.append(part)
    return tuple(key)


def _sentence(model: type[BaseModel], error: dict[str, Any], key: KeyPath) -> str:
    kind, value, context = error["type"], shown(error["input"]), error.get("ctx", {})
    if kind in _UNKNOWN:
        known = _known_keys(model, key[:-1])
        word = str(key[-1])
        hint = suggestion(word, known) or (f"; known are {', '.join(sorted(known))}" if known else "")
        return f"unknown key {word!r} (value {value}){hint}; correct or remove it"
    if kind in _MISSING:
        return "is missing; add it (docs/missions.md describes every key)"
    limits = {
        "greater_than": ("gt", "above"),
        "greater_than_equal": ("ge", "of at least"),
        "less_than": ("lt", "below"),
        "less_than_equal": ("le", "of at most"),
    }
    if kind in limits:
        name, words = limits[kind]
        return f"{value} is out of range; give a number {words} {context[name]:g}"
    if kind == "finite_number":
        return f"{value} is not a finite number; give one"
    if kind in ("value_error", "assertion_error"):
        cause = context.get("error")
        return str(cause) if cause is not None else str(error["msg"])
    if kind in ("literal_error", "enum"):
        return f"{value} is none of the choices; give {context['expected']}"
    wanted = {
        "float_type": "a number",
        "int_type": "a whole number",
        "int_from_float": "a whole number",
        "int_parsing_size": "a smaller whole number",
        "bool_type": "true or false",
        "string_type": "text",
        "tuple_type": "a list",
        "dict_type": "`key: value` lines",
        "model_type": "`key: value` lines",
        "dataclass_type": "`key: value` lines",
    }
    if kind in wanted:
        return f"{value} is of the wrong type; give {wanted[kind]}"
    if kind in ("too_short", "too_long", "string_too_short", "string_too_long"):
        return f"{value} has a wrong length: {error['msg'][0].lower()}{error['msg'][1:]}; add or remove entries"
    return f"{value} is wrong: {error['msg'][0].lower()}{error['msg'][1:]}; correct it"


def _known_keys(model: type[BaseModel], key: KeyPath) -> set[str]:
    """The keys that may stand where ``key`` points, from the model's own schema."""
    schema = model.model_json_schema()
    here: list[dict[str, Any]] = [schema]
    for part in key:
        here = [step for option in here for step in _steps(schema, option, part)]
    return {name for option in here for o in _options(schema, option) for name in o.get("properties", {})}


def _steps(schema: dict[str, Any], option: dict[str, Any], part: str | int) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    for o in _options(schema, option):
        if isinstance(part, int):
            items = [o["items"]] if isinstance(o.get("items"), dict) else o.get("prefixItems", [])[part : part + 1]
            found += items
        elif part in o.get("properties", {}):
            found.append(o["properties"][part])
        elif isinstance(o.get("additionalProperties"), dict):
            found.append(o["additionalProperties"])
    return found


def _options(schema: dict[str, Any], option: dict[str, Any]) -> list[dict[str, Any]]:
    if "$ref" in option:
        return _options(schema, schema["$defs"][option["$ref"].rsplit("/", 1)[1]])
    if "anyOf" in option or "oneOf" in option:
        return [o for each in (option.get("anyOf") or option["oneOf"]) for o in _options(schema, each)]
    return [option]
