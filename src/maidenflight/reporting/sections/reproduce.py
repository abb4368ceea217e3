"""How a run was made: the record of each file, as the page lists it."""

import json
from collections.abc import Mapping
from typing import Any

from markupsafe import Markup

from maidenflight.reporting.html import render
from maidenflight.reporting.run import Run

_NAMED = 20
"""Files of a kind that are not on the page and are named there."""

Row = tuple[str, str | list[str]]
"""A setting's name and its value; a list of inputs or the like has a line for each."""


def section(run: Run) -> Markup:
    """Returns how each file was made, and what else is in the folder."""
    return render(
        "reproduce.html",
        records=_records(run),
        others=run.other_files,
        missing=run.missing_files,
        most=_NAMED,
    )


def _records(run: Run) -> list[tuple[str, list[Row]]]:
    """Records by the names of their files; files that were made alike share an entry."""
    alike: dict[str, list[str]] = {}
    for name, record in run.records.items():
        shared = {key: value for key, value in record.items() if key != "number"}
        alike.setdefault(json.dumps(shared, sort_keys=True, default=str), []).append(name)
    return [(_files(names), _rows(json.loads(record))) for record, names in alike.items()]


def _files(names: list[str]) -> str:
    """Names of files, those of one folder together."""
    folders: dict[str, list[str]] = {}
    for name in names:
        folders.setdefault(name.rpartition("/")[0], []).append(name)
    return ", ".join(
        ", ".join(files) if not folder or len(files) == 1 else f"{folder}/ ({len(files)} files)"
        for folder, files in folders.items()
    )


def _rows(record: Mapping[str, Any], before: str = "") -> list[Row]:
    rows: list[Row] = []
    first = {"version": 0, "seed": 1, "inputs": 2}
    for key in sorted(record, key=lambda key: (first.get(key, 3), key)):
        value = record[key]
        if isinstance(value, dict):
            # Settings are most of a record, and need no word before each of them.
            rows += _rows(value, before if key == "settings" else f"{before}{key}.")
        elif isinstance(value, list) and any(isinstance(entry, str | dict) for entry in value):
            rows.append((before + key, [_line(entry) for entry in value]))
        else:
            rows.append((before + key, _written(value)))
    return rows


def _line(entry: Any) -> str:
    if not isinstance(entry, dict):
        return _written(entry)
    return ", ".join(f"{name} {_written(value)}" for name, value in entry.items())


def _written(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)
