"""Reads one YAML file into plain data, remembering the line of every key; hostile files end in a clear error."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from deploy.errors import InputError

KeyPath = tuple[str | int, ...]

MAX_BYTES = 1_000_000
MAX_DEPTH = 40
MAX_VALUES = 100_000

_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_INT = re.compile(r"[-+]?[0-9]+\Z")
_HEX = re.compile(r"0x[0-9a-fA-F]+\Z")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?\Z")
_CONSTANTS: dict[str, object] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".inf", ".Inf", ".INF", "+.inf"), math.inf),
    **dict.fromkeys(("-.inf", "-.Inf", "-.INF"), -math.inf),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), math.nan),
}


@dataclass(frozen=True, eq=False)
class Document:
    """A file as read.

    Attributes:
        path: where it was read from.
        raw: its bytes, for the copy in a run folder.
        data: mappings, lists, text, numbers, true/false and None.
        lines: line (from 1) of every key and list item.
    """

    path: Path
    raw: bytes
    data: dict[str, Any]
    lines: dict[KeyPath, int]

    def line(self, key: KeyPath) -> int | None:
        """Line of ``key`` or, where the file does not hold it, of the closest key above it."""
        for n in range(len(key), 0, -1):
            if key[:n] in self.lines:
                return self.lines[key[:n]]
        return None

    def error(self, what: str, key: KeyPath = ()) -> InputError:
        """An error at ``key`` of this file."""
        return InputError(what, file=self.path, key=dotted(key), line=self.line(key))


def dotted(key: KeyPath) -> str:
    """``("tasks", 0, "x")`` as ``tasks[0].x``."""
    text = ""
    for part in key:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            shown = part if part.isprintable() else repr(part)
            text += f".{shown}" if text else shown
    return text


def read_bytes(path: Path, max_bytes: int, role: str) -> bytes:
    """Reads a file of at most ``max_bytes``.

    Raises:
        InputError: naming the file and ``role`` (what it was wanted for).
    """
    try:
        with path.open("rb") as file:
            raw = file.read(max_bytes + 1)
    except FileNotFoundError:
        raise InputError(f"this {role} does not exist; check the path and its spelling", file=path) from None
    except IsADirectoryError:
        raise InputError(f"this is a folder, not a {role}; name the file in it", file=path) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(
            f"this {role} cannot be read ({reason}); check the path and its permissions", file=path
        ) from None
    if len(raw) > max_bytes:
        raise InputError(f"this {role} is larger than {max_bytes} bytes; give a smaller one", file=path)
    return raw


def decode(raw: bytes, path: Path) -> str:
    """UTF-8 text of ``raw``.

    Raises:
        InputError: naming the line where it is not UTF-8.
    """
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        byte = raw[error.start]
        raise InputError(f"byte 0x{byte:02x} is not UTF-8 text; save the file as UTF-8", file=path, line=line) from None


def read_yaml(path: Path, role: str) -> Document:
    """Reads a YAML file whose top level is a mapping.

    Only what YAML 1.2 calls its core schema is understood (``yes`` is text, a date is text), tags are refused,
    aliases are allowed but what they expand to is bounded.

    Raises:
        InputError: naming the file, where possible the line, and the remedy.
    """
    raw = read_bytes(path, MAX_BYTES, role)
    return parse_yaml(raw, path, role)


def parse_yaml(raw: bytes, path: Path, role: str) -> Document:
    """As ``read_yaml``, of bytes at hand.

    Raises:
        InputError: naming the file, where possible the line, and the remedy.
    """
    text = decode(raw, path)
    builder = _Builder(path)
    try:
        data = builder.build(yaml.parse(text, Loader=_LOADER))
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or getattr(error, "reason", None) or str(error)
        line = mark.line + 1 if mark is not None else None
        raise InputError(
            f"this is not YAML: {problem}; mend the indentation or the quotes", file=path, line=line
        ) from None
    if data is None:
        raise InputError(f"this {role} is empty; start from one in mission_configs/", file=path)
    if not isinstance(data, dict):
        raise InputError(f"the top level of a {role} must be `key: value` lines, not {_shown(data)}", file=path, line=1)
    return Document(path, raw, data, builder.lines)


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


@dataclass
class _Open:
    """A collection whose end has not come yet."""

    value: dict[str, Any] | list[Any]
    anchor: str | None
    path: KeyPath
    key: str | None = None
    awaits_key: bool = True
    values_before: int = 0
    height: int = 1


class _Builder:
    """Builds data from parse events with a stack of its own, so that no file exhausts Python's."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.lines: dict[KeyPath, int] = {}
        self._anchors: dict[str, tuple[Any, int, int]] = {}  # value, values in it, levels in it
        self._values = 0
        self._line = 1

    def build(self, events: Iterator[Any]) -> Any:
        """The document's value; None for an empty file."""
        stack: list[_Open] = []
        root: Any = None
        documents = 0
        for event in events:
            self._line = event.start_mark.line + 1
            if isinstance(event, yaml.DocumentStartEvent):
                documents += 1
                if documents > 1:
                    raise self._error("a second document begins here; keep one document in a file")
            elif isinstance(event, yaml.AliasEvent):
                if event.anchor not in self._anchors:
                    raise self._error(
                        f"alias *{event.anchor} refers to nothing before it, or to itself; write the value out"
                    )
                value, size, height = self._anchors[event.anchor]
                self._count(size)
                self._deepen(stack, height)
                root = self._put(stack, value, root)
            elif isinstance(event, yaml.ScalarEvent):
                size = 1 + len(event.value) // 50  # long text aliased often is a bomb, too
                self._count(size)
                self._refuse_tag(event.tag)
                awaits_key = bool(stack) and isinstance(stack[-1].value, dict) and stack[-1].awaits_key
                value = event.value if awaits_key or not event.implicit[0] else self._scalar(event.value)
                root = self._put(stack, value, root)
                if event.anchor:
                    self._anchors[event.anchor] = (value, size, 0)
            elif isinstance(event, yaml.MappingStartEvent | yaml.SequenceStartEvent):
                self._count(1)
                self._refuse_tag(event.tag)
                self._deepen(stack, 1)
                new: dict[str, Any] | list[Any] = {} if isinstance(event, yaml.MappingStartEvent) else []
                root = self._put(stack, new, root)
                stack.append(_Open(new, event.anchor, self._last_path, values_before=self._values - 1))
            elif isinstance(event, yaml.MappingEndEvent | yaml.SequenceEndEvent):
                done = stack.pop()
                if stack:
                    stack[-1].height = max(stack[-1].height, done.height + 1)
                if done.anchor:
                    self._anchors[done.anchor] = (done.value, self._values - done.values_before, done.height)
        return root

    _last_path: KeyPath = ()

    def _put(self, stack: list[_Open], value: Any, root: Any) -> Any:
        if not stack:
            self._last_path = ()
            return value
        top = stack[-1]
        if isinstance(top.value, list):
            self._last_path = (*top.path, len(top.value))
            top.value.append(value)
        elif top.awaits_key:
            if not isinstance(value, str):
                raise self._error(f"a key must be one word, not {_shown(value)}; put it in quotes")
            if value in top.value:
                first = self.lines[(*top.path, value)]
                raise InputError(
                    f"this key is given twice, first in line {first}; keep one ({value!r})",
                    file=self.path,
                    key=dotted((*top.path, value)),
                    line=self._line,
                )
            top.key, top.awaits_key = value, False
            self._last_path = (*top.path, value)
        else:
            assert top.key is not None
            self._last_path = (*top.path, top.key)
            top.value[top.key], top.awaits_key = value, True
            return root
        self.lines[self._last_path] = self._line
        return root

    def _deepen(self, stack: list[_Open], levels: int) -> None:
        if len(stack) + levels > MAX_DEPTH:
            raise self._error(f"nested deeper than {MAX_DEPTH} levels; no mission needs that")
        if stack:
            stack[-1].height = max(stack[-1].height, levels + 1)

    def _count(self, n: int) -> None:
        self._values += n
        if self._values > MAX_VALUES:
            raise self._error(
                f"holds or expands to more than {MAX_VALUES} values; put long lists in a CSV or GeoJSON file"
            )

    def _refuse_tag(self, tag: str | None) -> None:
        if tag is not None and tag not in ("!", "tag:yaml.org,2002:str"):
            raise self._error(f"tag {tag!r} is not understood; remove it")

    def _scalar(self, text: str) -> object:
        if text in _CONSTANTS:
            return _CONSTANTS[text]
        if _INT.match(text) and len(text) <= 300:
            return int(text)
        if _HEX.match(text):
            return int(text, 16)
        return float(text) if _FLOAT.match(text) else text

    def _error(self, what: str) -> InputError:
        return InputError(what, file=self.path, line=self._line)
