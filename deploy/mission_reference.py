"""The tables of all keys in ``docs/missions.md``, made from the models so that they cannot rot."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from deploy.mission_fleet import UavConfig, UgvConfig
from deploy.mission_model import MissionConfig

PAGE = Path(__file__).parent.parent / "docs" / "missions.md"
MARK = "<!-- keys: written by `python -m deploy.mission_schema` -->"


def page(text: str) -> str:
    """``text`` of the page with its tables renewed: what follows the mark is replaced."""
    return text[: text.index(MARK)] + MARK + "\n\n" + reference()


def reference() -> str:
    """All tables."""
    parts = [_tables(MissionConfig.model_json_schema(), "Mission file", skip=("LonLat", "FleetSection"))]
    own = set(UavConfig.model_fields) & set(UgvConfig.model_fields)
    both = {k: v for k, v in UavConfig.model_json_schema()["properties"].items() if k in own and k != "kind"}
    # Kinds share these keys but not all of their defaults.
    ugv = UgvConfig.model_json_schema()["properties"]
    for key, value in both.items():
        if value.get("default") != ugv[key].get("default"):
            value["default"] = f"UAV {value.get('default')}, UGV {ugv[key].get('default')}"
        if value.get("description") != ugv[key].get("description"):
            value["description"] = f"{value['description']} {ugv[key]['description']}"
    parts.append("### Fleet: every vehicle\n\n" + _table({"properties": both}))
    for title, model in (("Fleet: UAVs", UavConfig), ("Fleet: UGVs", UgvConfig)):
        schema = model.model_json_schema()
        schema["properties"] = {k: v for k, v in schema["properties"].items() if k not in own}
        parts.append(f"### {title}\n\n" + _table(schema))
    options = {**UavConfig.model_json_schema().get("$defs", {}), **UgvConfig.model_json_schema().get("$defs", {})}
    for name, section in sorted(options.items()):
        about = section.get("description", "").partition("\n")[0]
        owners = (o for o, other in options.items() if f"#/$defs/{name}" in json.dumps(other))
        where = ".".join(n.removesuffix("Options").lower() for n in (*owners, name))
        parts.append(f"### Fleet: `{where}`\n\n{about}\n\n{_table(section)}")
    return "\n".join(parts)


def _tables(schema: dict[str, Any], title: str, skip: tuple[str, ...]) -> str:
    text = f"### {title}\n\n{_table(schema)}\n"
    for name, section in schema["$defs"].items():
        if name not in skip and "properties" in section:
            where = _where(schema, name)
            about = section.get("description", "").partition("\n")[0].replace("``", "`")
            text += f"### `{where}`\n\n{about}\n\n{_table(section)}\n"
    return text


def _where(schema: dict[str, Any], name: str) -> str:
    """Dotted key at which a section stands."""
    for owner, section in (("", schema), *schema["$defs"].items()):
        for key, value in section.get("properties", {}).items():
            if f"#/$defs/{name}" in json.dumps(value):
                key_ = f"{key}[]" if "items" in value else key
                return key_ if owner == "" else f"{_where(schema, owner)}.{key_}"
    return name


def _table(section: dict[str, Any]) -> str:
    rows = ["| key | type | default | meaning |", "| --- | --- | --- | --- |"]
    for key, value in section["properties"].items():
        required = key in section.get("required", ())
        meaning = value.get("description") or _attribute(section.get("description", ""), key)
        meaning = " ".join(meaning.split()).replace("|", "\\|").replace("``", "`")
        rows.append(f"| `{key}` | {_type(value)} | {'**required**' if required else _default(value)} | {meaning} |")
    return "\n".join(rows) + "\n"


def _attribute(docstring: str, key: str) -> str:
    """What the ``Attributes:`` of a docstring say about ``key``."""
    entry = rf"^( *)(?:[\w, ]+, )?{key}(?:, [\w, ]+)?: (.*(?:\n\1 +\S.*)*)"
    found = re.search(entry, docstring, re.MULTILINE)
    text = " ".join(found[2].split()) if found else ""
    return text[:1].upper() + text[1:]


def _default(value: dict[str, Any]) -> str:
    default = value.get("default")
    if default is None:
        return ""
    if isinstance(default, dict):
        return "see below"
    return str(default) if isinstance(default, str) and default.startswith("UAV") else f"`{json.dumps(default)}`"


def _type(value: dict[str, Any]) -> str:
    if "$ref" in value:
        name = str(value["$ref"]).rsplit("/", 1)[1]
        return "one of the fault kinds" if name == "FaultKind" else "section"
    if "anyOf" in value or "oneOf" in value:
        options = [_type(option) for option in value.get("anyOf") or value["oneOf"] if option.get("type") != "null"]
        if len(options) == 2 and "section" in options:
            return "point"
        return " or ".join(dict.fromkeys(options))
    if "enum" in value:
        return " or ".join(f"`{json.dumps(v)}`" for v in value["enum"])
    if "const" in value:
        return f"`{json.dumps(value['const'])}`"
    names = {
        "number": "number",
        "integer": "whole number",
        "string": "text",
        "boolean": "true/false",
        "object": "mapping",
    }
    if value.get("type") == "array":
        return "list"
    limits = [
        f"{sign} {value[name]:g}"
        for name, sign in (("exclusiveMinimum", ">"), ("minimum", "≥"), ("exclusiveMaximum", "<"), ("maximum", "≤"))
        if name in value
    ]
    return " ".join([names.get(str(value.get("type")), "text"), ", ".join(limits)]).strip()
