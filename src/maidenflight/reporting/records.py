"""How a run was made, and how long it took: what it takes to make it again."""

import json
from collections.abc import Mapping
from html import escape
from typing import Any

from maidenflight.reporting.run import Run


def seconds(run: Run) -> str:
    """How long each stage took, as bars."""
    if not run.seconds:
        return ""
    longest, total = max(run.seconds.values()) or 1.0, sum(run.seconds.values())
    rows = [
        f"<tr><th scope=row>{escape(stage)}</th><td>{time:.1f} s</td>"
        f'<td class=bar><i style="width:{100 * time / longest:.1f}%"></i></td></tr>'
        for stage, time in run.seconds.items()
    ]
    rows.append(f"<tr><th scope=row>all stages</th><td>{total:.1f} s</td><td></td></tr>")
    return (
        f'<h3>Time of each stage</h3><table class="stages"><tbody>{"".join(rows)}</tbody></table>'
    )


def records(run: Run) -> str:
    """How each file was made.

    Files made alike share a table, and one of many policies stands for all.
    """
    alike: dict[str, list[str]] = {}
    for name, record in run.records.items():
        told = {key: value for key, value in record.items() if key != "number"}
        alike.setdefault(json.dumps(told, sort_keys=True, default=str), []).append(name)
    parts = []
    for record, names in alike.items():
        rows = "".join(
            f"<tr><th scope=row>{escape(key)}</th><td>{value}</td></tr>"
            for key, value in _flat(json.loads(record))
        )
        parts.append(
            f"<h3>{escape(_files(names))}</h3><div class=scroll><table "
            f"class=record><tbody>{rows}</tbody></table></div>"
        )
    return "".join(parts)


def _files(names: list[str]) -> str:
    """Names of files, those of one folder together."""
    folders: dict[str, list[str]] = {}
    for name in names:
        folders.setdefault(name.rpartition("/")[0], []).append(name)
    return ", ".join(
        ", ".join(held) if not folder or len(held) == 1 else f"{folder}/ ({len(held)} files)"
        for folder, held in folders.items()
    )


def _flat(record: Mapping[str, Any], before: str = "") -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    for key in sorted(
        record, key=lambda key: ({"version": 0, "seed": 1, "inputs": 2}.get(key, 3), key)
    ):
        value = record[key]
        if isinstance(value, dict):
            # What a maker was told is most of a record, and needs no word before each of its lines.
            rows += _flat(value, before if key == "settings" else f"{before}{key}.")
        elif isinstance(value, list) and any(isinstance(entry, str | dict) for entry in value):
            lines = [
                entry
                if isinstance(entry, str)
                else ", ".join(f"{name} {_said(each)}" for name, each in entry.items())
                for entry in value
            ]
            rows.append((before + key, f"<div class=lines>{'<br>'.join(map(escape, lines))}</div>"))
        else:
            rows.append((before + key, escape(_said(value))))
    return rows


def _said(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)
