"""Results as a CSV file that grows by a row at a time: what is in it is not measured again."""

from __future__ import annotations

import csv
import io
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path


class Rows:
    """The rows of a file, all values as text. A last line that an interrupted run cut off is dropped."""

    def __init__(self, path: Path, fields: Sequence[str]) -> None:
        self.path, self.fields = path, fields
        self.rows: list[dict[str, str]] = []
        path.parent.mkdir(parents=True, exist_ok=True)
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        whole = text[: text.rfind("\n") + 1]
        reader = csv.DictReader(whole.splitlines())
        if reader.fieldnames is not None and list(reader.fieldnames) != list(fields):
            sys.exit(f"{path}: these are other results; give another --out")
        self.rows = list(reader)
        if whole != text or not whole:
            self._write(whole or ",".join(fields) + "\n")

    def _write(self, text: str) -> None:
        part = self.path.with_suffix(".part")
        part.write_text(text, encoding="utf-8")
        part.replace(self.path)

    def add(self, row: Mapping[str, object]) -> None:
        """Keeps one more row, in the file as well."""
        with self.path.open("a", newline="", encoding="utf-8") as file:
            csv.DictWriter(file, self.fields, lineterminator="\n").writerow(row)
        self.rows.append({key: str(value) for key, value in row.items()})

    def keep(self, which: Callable[[Mapping[str, str]], bool]) -> None:
        """Drops all other rows, from the file as well."""
        kept = [row for row in self.rows if which(row)]
        if len(kept) == len(self.rows):
            return
        self.rows, text = kept, io.StringIO()
        writer = csv.DictWriter(text, self.fields, lineterminator="\n")
        writer.writeheader()
        writer.writerows(kept)
        self._write(text.getvalue())
