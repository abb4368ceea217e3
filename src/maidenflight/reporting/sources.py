"""What a report is made of: files and folders as a user gives them, known by what they hold.

A folder may be that of a demo, of one stage, or of flight logs. Files that a command
writes are known by their names too, so that a broken one is told and not passed over.
"""

import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from maidenflight import inputs, run_folder
from maidenflight.errors import InputError
from maidenflight.flights import foreign, formats, reading
from maidenflight.flights.log import FAMILY
from maidenflight.run_folder import Table

_TABLES: tuple[tuple[str, Table, frozenset[str]], ...] = (
    ("windows", run_folder.WINDOWS, frozenset({"window", "model", "time"})),
    ("validation", run_folder.VALIDATION, frozenset({"model", "horizon"})),
    ("table", run_folder.FLIGHTS, frozenset({"policy", "reality", "trial", "duration"})),
    ("prediction", run_folder.PREDICTION, frozenset({"policy", "trial", "duration"})),
    ("training", run_folder.TRAINING, frozenset({"steps", "policy", "episode_return"})),
    ("evaluations", run_folder.EVALUATIONS, frozenset({"objective"})),
    ("study", run_folder.STUDY, frozenset({"task", "kind"})),
)
"""What a table is of a report, its kind, and columns by which it is known."""
_NAMES = {
    run_folder.DRONE: "drone",
    run_folder.REALITY: "truth",
    run_folder.STAGES: "stages",
    **{table.name: part for part, table, _ in _TABLES},
}
"""What files are, by the names that commands give them."""
_NUMBERED = {
    f"{run_folder.POLICY.stem}_*{run_folder.POLICY.suffix}": "policies",
    f"{run_folder.LOG.stem}_*{run_folder.LOG.suffix}": "logs",
}
"""What files are that a command numbers."""
WORDS = {
    "drone": "identified drones",
    "truth": "virtual drones",
    "evaluations": "evaluations",
    "validation": "prediction errors",
    "windows": "predicted windows",
    "policies": "policies",
    "training": "training",
    "table": "test flights",
    "prediction": "predicted flights",
    "stages": "stages",
    "study": "results of a study",
    "logs": "flight logs",
    "tested": "flight logs",
}
"""What the parts are, in words."""


@dataclass(frozen=True)
class Sources:
    """The files of a report; a part that is missing is `None` or empty."""

    drone: Path | None = None
    truth: Path | None = None
    """The parameters of a virtual drone that was recorded."""
    evaluations: Path | None = None
    """Of an identification's objective."""
    validation: Path | None = None
    windows: Path | None = None
    policies: tuple[Path, ...] = ()
    training: Path | None = None
    table: Path | None = None
    """Test flights, a row each."""
    tested: tuple[Path, ...] = ()
    """Logs of the test flights."""
    prediction: Path | None = None
    stages: Path | None = None
    study: Path | None = None
    """What the tasks of a study found."""
    logs: tuple[Path, ...] = ()
    """Recorded flights, in any format that `identify` reads."""
    others: Mapping[str, list[str]] = field(default_factory=dict)
    """Names of what else the folders hold, by kind."""

    @property
    def parts(self) -> dict[str, Any]:
        """What there is."""
        found = {each.name: getattr(self, each.name) for each in fields(self)}
        return {name: part for name, part in found.items() if part and name != "others"}


def find(given: Sequence[Path]) -> Sources:
    """The files of a report.

    Args:
        given: files and folders. A file comes before one of its kind in a folder.

    Raises:
        InputError: something does not exist or is of no known kind, or there are two of what a
            report shows one of.
    """
    folders = [_of_folder(path) for path in given if path.is_dir()]
    files = [_of_file(path) for path in given if not path.is_dir()]
    found = _together(folders)
    named = _together(files)
    merged = {**found.parts, **named.parts}
    for several in ("policies", "logs", "tested"):
        merged[several] = tuple(dict.fromkeys((*getattr(found, several), *getattr(named, several))))
    return Sources(**merged, others=found.others)  # type: ignore[arg-type]


def nothing(given: Sequence[Path]) -> str:
    """What to say where there is nothing for a report, and what of it may hold flights."""
    unread = [foreign.below(path)[0] for path in given if path.is_dir()]
    kinds = sum(unread, Counter[foreign.Foreign]())
    return (
        f"{' '.join(map(str, given))}: nothing of a run here; expected flight logs, a drone "
        "(.toml), policies (.json), or tables that maidenflight has written."
        + (f" Found: {foreign.told(kinds)}" if kinds else "")
    )


def _together(parts: Iterable[Sources]) -> Sources:
    """The parts of several places.

    Raises:
        InputError: two of them hold what a report shows one of.
    """
    found = Sources()
    for part in parts:
        for name, value in part.parts.items():
            held = getattr(found, name)
            if isinstance(value, tuple):
                found = replace(found, **{name: (*held, *value)})
            elif held in (None, value):
                found = replace(found, **{name: value})
            else:
                raise InputError(
                    f"{held} and {value}: both hold {WORDS[name]}, of which a report shows one. "
                    "Give one of them, or make two reports."
                )
        others = {
            kind: [*found.others.get(kind, []), *names] for kind, names in part.others.items()
        }
        found = replace(found, others={**found.others, **others})
    return found


def _of_file(path: Path) -> Sources:
    if not os.path.lexists(path):
        raise InputError(
            f"{path}: no such file or folder. Give the folder of a run, such as maidenflight demo "
            "writes, or its files."
        )
    kind = kind_of(path)
    if kind is None:
        raise InputError(
            f"{path}: nothing that a report shows; expected a drone (.toml), a policy (.json), "
            f"flight logs ({', '.join(formats.SUFFIXES)}) or a table that maidenflight has written."
        )
    part: dict[str, Any] = {kind: (path,) if kind in ("policies", "logs") else path}
    return _beside(Sources(**part))


def _beside(found: Sources) -> Sources:
    """With the second files of an identification and of a validation, which stand beside them."""
    if found.drone is not None and found.evaluations is None:
        second = run_folder.beside(found.drone)
        found = replace(found, evaluations=second if os.path.lexists(second) else None)
    if found.validation is not None and found.windows is None:
        second = run_folder.windows_beside(found.validation)
        found = replace(found, windows=second if os.path.lexists(second) else None)
    return found


def _of_folder(folder: Path) -> Sources:
    """What a run's folder holds, at its top and in the folders that commands write."""
    held = _held(folder)
    home = _below(folder, *run_folder.RECORDED)
    tested = _below(folder, run_folder.TRANSFER)
    trained = _below(folder, run_folder.POLICIES)
    table = _one(_within(tested, held, folder, "table"), run_folder.FLIGHTS.name)
    own = run_folder.LOG.find(tested) if table is not None else []
    logs = [path for path in _within(home, held, folder, "logs") if path not in own]
    single: dict[str, Any] = {
        name: _one(held.get(name, []), *(known for known, part in _NAMES.items() if part == name))
        for name in ("drone", "validation", "prediction", "stages", "study")
    }
    truth = _one(held.get("truth", []) or _held(home).get("truth", []), run_folder.REALITY)
    found = _beside(
        Sources(
            **single,
            truth=truth,
            table=table,
            tested=tuple(own),
            policies=tuple(_numbered(_within(trained, held, folder, "policies"))),
            training=_one(_within(trained, held, folder, "training"), run_folder.TRAINING.name),
            logs=tuple(_numbered(logs)),
        )
    )
    if not found.parts:
        return Sources(logs=tuple(reading.log_files(folder)))
    if found.evaluations is None:
        alone = _one(held.get("evaluations", []), run_folder.EVALUATIONS.name)
        found = replace(found, evaluations=alone if found.drone is None else None)
    if found.windows is None:
        found = replace(found, windows=_one(held.get("windows", []), run_folder.WINDOWS.name))
    shown = {home, tested, trained}
    return replace(found, others=_others(folder, held, found, shown))


def _below(folder: Path, *names: str) -> Path:
    """The first folder of these names in a run's, or else that itself: it is one of a stage."""
    return next((folder / name for name in names if (folder / name).is_dir()), folder)


def _within(place: Path, held: Mapping[str, list[Path]], folder: Path, kind: str) -> list[Path]:
    return (held if place == folder else _held(place)).get(kind, [])


def _held(folder: Path) -> dict[str, list[Path]]:
    """Files at a folder's top, by what they are; also what only has the name of such a file."""
    held: dict[str, list[Path]] = {}
    for path in sorted(folder.iterdir()):
        named = path.name in _NAMES or any(path.match(pattern) for pattern in _NUMBERED)
        if named or not (path.is_dir() or path.name.startswith(".")):
            kind = kind_of(path)
            if kind is not None:
                held.setdefault(kind, []).append(path)
    return held


def _one(paths: Sequence[Path], *names: str) -> Path | None:
    """The file of a name, or else the only one there is."""
    named = [path for path in paths if path.name in names]
    return next(iter(named or (paths if len(paths) == 1 else [])), None)


def _numbered(paths: Sequence[Path]) -> list[Path]:
    """By the number in the name: flight_100 after flight_99."""
    return sorted(paths, key=run_folder.by_number)


def _others(
    folder: Path, held: Mapping[str, list[Path]], found: Sources, shown: set[Path]
) -> dict[str, list[str]]:
    """Names of folders and files of a run that a page does not show, by what they hold."""
    used = set()
    for part in found.parts.values():
        used |= set(part) if isinstance(part, tuple) else {part}
    others: dict[str, list[str]] = {}
    for place in sorted(folder.iterdir()):
        if place.is_dir() and place not in shown and not place.name.startswith("."):
            kinds = {kind_of(path) for path in sorted(place.iterdir()) if path.is_file()}
            kind = next((kind for kind in ("table", "policies", "logs") if kind in kinds), None)
            if kind is not None:
                others.setdefault(WORDS[kind], []).append(f"{place.name}/")
    for kind in ("prediction", "validation", "drone", "logs"):
        for path in held.get(kind, []):
            if path not in used:
                others.setdefault(WORDS[kind], []).append(path.name)
    return others


def kind_of(path: Path) -> str | None:
    """The part of a report, a field of `Sources`, that a file is; nothing where it is none."""
    named = _NAMES.get(path.name)
    if path.suffix == ".csv":
        with suppress(OSError, UnicodeDecodeError):
            return _of_csv(path, named)
    named = named or next((part for names, part in _NUMBERED.items() if path.match(names)), None)
    if named is not None:
        return named
    with suppress(OSError, UnicodeDecodeError, ValueError):
        if path.suffix == ".toml":
            return _of_toml(inputs.text(path))
        if path.suffix == ".json":
            content = inputs.from_json(inputs.text(path))
            is_policy = isinstance(content, dict) and not {"layers", "0"}.isdisjoint(content)
            return "policies" if is_policy else None
    return "logs" if formats.is_log(path) else None


def _of_toml(text: str) -> str | None:
    content = inputs.from_toml(text)
    if "identification" in content:
        return "drone"
    record = content.get("record")
    settings = record.get("settings") if isinstance(record, dict) else None
    return "truth" if isinstance(settings, dict) and "reality" in settings else None


def _of_csv(path: Path, named: str | None) -> str:
    first, columns = next(iter(inputs.comments(path)), ""), set(inputs.header(path).split(","))
    if first.startswith(FAMILY):
        return "logs"
    # A broken one is still known by its name, unless it is somebody else's table of flights.
    own = {name for part, table, _ in _TABLES if part == named for name in table.columns}
    words = len(columns) > 2 and all(map(str.isidentifier, columns))
    if named and not (named == "table" and words and len(own & columns) < 0.4 * len(columns)):
        return named
    for part, table, known in _TABLES:
        if known <= columns or (table.heading and first.startswith(_mark(table))):
            return part
    return "logs"


def _mark(table: Table) -> str:
    """How a table's first line begins."""
    return "# " + table.heading.partition(":")[0].rstrip("0123456789 ")
