"""A copy of a mission that needs nothing else: for the run folder, from which the run is replayed and resumed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from deploy.errors import InputError
from deploy.mission import Mission


def save_copy(mission: Mission, folder: Path) -> Path:
    """Writes the mission as it was loaded, overrides included, with every file it names.

    Args:
        mission: as loaded; the bytes read then are written, not what the files hold now.
        folder: created where missing.

    Returns:
        the copied mission file, ``folder/mission.yaml``; ``load`` gives the same digest from it.

    Raises:
        InputError: when the folder cannot be written.
    """
    names = {source.role: f"{source.role}{source.path.suffix.lower()}" for source in mission.sources}
    data = dict(mission.data)
    for role in ("fleet", "map", "tasks", "path_points"):
        if role in names:
            data[role] = {**data[role], "file": names[role]}
    written: dict[str, bytes] = {s.role: s.raw for s in mission.sources}
    written["mission"] = _yaml(
        data, f"# Mission {mission.name!r} as run; written by the program from {mission.path}.\n"
    )
    if mission.map_data is not None:
        written["map"] = _yaml({**mission.map_data, "image": names["image"]}, "# Copy; see mission.yaml.\n")
    names["mission"] = "mission.yaml"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for role, name in names.items():
            (folder / name).write_bytes(written[role])
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror}); choose another folder", file=folder) from None
    return folder / names["mission"]


class _Quoting(yaml.SafeDumper):
    """Quotes all text: PyYAML would leave ``1e3`` bare, which YAML 1.2 reads as a number."""


_Quoting.add_representer(str, lambda dumper, text: dumper.represent_scalar("tag:yaml.org,2002:str", text, style='"'))


def _yaml(data: dict[str, Any], comment: str) -> bytes:
    text = yaml.dump(data, Dumper=_Quoting, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)
    return (comment + text).encode()
