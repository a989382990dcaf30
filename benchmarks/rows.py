"""Results as a CSV file that grows by a row at a time: what is in it is not measured again."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path


class Rows:
    """The rows of a file, all values as text. A last line that an interrupted run cut off is dropped."""

    def __init__(self, path: Path, fields: Sequence[str]) -> None:
        self.path, self.fields = path, fields
        self.rows: list[dict[str, str]] = []
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists():
            with path.open(newline="", encoding="utf-8") as file:
                whole = "".join(line for line in file if line.endswith("\n"))
            self.rows = list(csv.DictReader(whole.splitlines()))
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, fields, lineterminator="\n")
            writer.writeheader()
            writer.writerows(self.rows)

    def add(self, row: Mapping[str, object]) -> None:
        """Keeps one more row, in the file as well."""
        with self.path.open("a", newline="", encoding="utf-8") as file:
            csv.DictWriter(file, self.fields, lineterminator="\n").writerow(row)
        self.rows.append({key: str(value) for key, value in row.items()})
