"""The table of a study: entries with grids, and the tasks that they stand for.

A study is a TOML file, or a list of the same tables in Python:

    [[task]]
    name = "policy"                     # of your choice
    kind = "train"                      # a verb of the command line, or MODULE:NAME of your own
    settings = { drone = "crazyflie", policies = 8, updates = 800 }
    grid = { control = ["pwm", "attitude"], seed = { first = 0, count = 20 } }

    [[task]]
    name = "flown"
    kind = "transfer"
    settings = { reality = ["virtual:7"] }
    inputs = { policies = "policy" }    # for each point of its grid

A task takes its inputs' points of the grid: where two inputs have an entry behind them in common,
their points agree. A grid may sweep one value of a table, as in `"set.latency" = [0.0, 0.02]`.
"""

import hashlib
import itertools
import json
import math
import os
import re
from collections.abc import Mapping, Sequence
from contextlib import chdir
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from maidenflight import __version__, budget, inputs, results
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.registry import VERBS
from maidenflight.settings import PENDING, REQUIRED, Setting, find_code, plain
from maidenflight.verb import Verb, find_verb

MAX_TASKS = budget.STUDY.limits["tasks"]
"""Tasks of a study at most."""
_ENTRIES = ("name", "kind", "settings", "grid", "inputs")


@dataclass(frozen=True)
class Task:
    """One task: an entry of the study at a point of its grid."""

    name: str
    """Of the entry."""
    kind: str
    settings: Mapping[str, Any]
    """All settings but those that other tasks make; paths are relative to the study's folder."""
    point: Mapping[str, Any]
    """What is swept, by `ENTRY.SETTING`, that of its inputs included."""
    inputs: Mapping[str, str]
    """Keys of the tasks that make settings."""
    key: str
    """Names the result: a hash of kind, settings, content of files, inputs and version."""

    @property
    def label(self) -> str:
        """For people."""
        swept = ", ".join(f"{name} {to_cell(value)}" for name, value in self.point.items())
        return f"{self.name} ({swept})" if swept else self.name


@dataclass(frozen=True)
class Study:
    """Tasks in the order of the table, inputs before those that take them."""

    tasks: tuple[Task, ...]
    home: Path
    """The folder that paths are relative to."""
    entries: tuple[Mapping[str, Any], ...]
    """As the study has them."""
    cpus: int = 1
    gpus: int = 0


@dataclass(frozen=True)
class _Entry:
    name: str
    label: str
    """For errors."""
    kind: str
    verb: type[Verb]
    settings: dict[str, Any]
    grid: dict[str, list[Any]]
    inputs: dict[str, str]


def to_cell(value: Any) -> Any:
    """Converts a setting to what a table shows."""
    if isinstance(value, dict):
        return ", ".join(f"{name}={entry}" for name, entry in value.items())
    return ", ".join(map(str, value)) if isinstance(value, list) else value


def settings_of(verb: type[Verb]) -> dict[str, Setting]:
    """Returns the settings of a verb that a study may set: all on which its results depend."""
    return {name: setting for name, (_, setting) in verb.settings().items() if setting.recorded}


def read_study(path: StrPath, cpus: int = 1, gpus: int = 0, *, trust: bool = False) -> Study:
    """Reads a study.

    Args:
        path: a TOML file.
        cpus: cores of each task. They are part of what names a result: sums over more devices are
            rounded differently.
        gpus: GPUs of each task, likewise.
        trust: whether the file may name Python code, `MODULE:NAME`, which is then imported.

    Raises:
        InputError: it is missing or no TOML, it names code without trust, or see `of`.
    """
    cure = "Give a TOML file with tables [[task]] alone; see docs/clusters.md."
    content = inputs.toml_file(path, "a study", cure)
    if unknown := content.keys() - {"task"}:
        raise InputError(f"{path}: {min(unknown)} is unknown. {cure}")
    if not trust and (code := _find_code(content)):
        raise InputError(
            f"{path}: {code} is Python code, which anybody may have written. Look at it, then add "
            "--trust (in Python trust=True)."
        )
    return of(content.get("task"), Path(path).resolve().parent, str(path), cpus, gpus)


def _find_code(content: Mapping[str, Any]) -> str | None:
    """Returns the first name of Python code among the verbs and settings of a study's tables."""
    entries = content.get("task")
    for entry in entries if isinstance(entries, list) else []:
        kind = entry.get("kind") if isinstance(entry, dict) else None
        if isinstance(kind, str) and ":" in kind:
            return kind
        is_verb = isinstance(kind, str) and kind in VERBS
        settings = settings_of(find_verb(str(kind))) if is_verb else {}
        for part in (entry.get("settings"), entry.get("grid")) if settings else ():
            for name, value in part.items() if isinstance(part, dict) else ():
                setting = settings.get(name.partition(".")[0])
                if setting is not None and (code := find_code(setting.values, value)):
                    return code
    return None


def of(
    entries: Any, home: StrPath = ".", source: str = "the study", cpus: int = 1, gpus: int = 0
) -> Study:
    """Returns a study of tables.

    Args:
        entries: a list of them, as `read` reads.
        home: folder that paths in them are relative to.
        source: what holds them, for errors.
        cpus: see `read`.
        gpus: see `read`.

    Raises:
        InputError: an entry is unknown, missing or out of range; a file is not there; an input
            stands for no earlier entry, or for one of the wrong kind; or there are too many tasks.
    """
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{source}: no tasks. Expected tables [[task]]; see docs/clusters.md.")
    home = Path(home).resolve()
    known: dict[str, _Entry] = {}
    expanded_tasks: dict[str, list[Task]] = {}
    digests: dict[str, list[str]] = {}
    for number, content in enumerate(entries, 1):
        entry = _entry(content, f"{source}: task {number}", known)
        known[entry.name] = entry
        with chdir(home):
            expanded_tasks[entry.name] = _expanded(entry, expanded_tasks, digests, (cpus, gpus))
        if sum(map(len, expanded_tasks.values())) > MAX_TASKS:
            raise InputError(f"{source}: more than {MAX_TASKS} tasks. Make several studies of it.")
    return Study(tuple(itertools.chain(*expanded_tasks.values())), home, tuple(entries), cpus, gpus)


def _entry(content: Any, label: str, known: Mapping[str, _Entry]) -> _Entry:
    if not isinstance(content, dict):
        raise InputError(f"{label}: is {str(content)[:40]!r}; expected a table [[task]].")
    for name in content:
        if name not in _ENTRIES:
            raise InputError(f"{label}: {name} is unknown. Expected {', '.join(_ENTRIES)}.")
    called = content.get("name")
    if not isinstance(called, str) or not called or "." in called or called in known:
        raise InputError(f"{label}: name = {called!r}; expected a text of its own without a dot.")
    label = f"{label} ({called})"
    kind = content.get("kind")
    try:
        verb = find_verb(str(kind))
    except InputError as error:
        raise InputError(f"{label}: kind = {error}") from error
    if not isinstance(kind, str) or not verb.in_studies:
        raise InputError(f"{label}: kind = {kind!r}; {verb.name} is no task of a study.")
    parts = {name: content.get(name, {}) for name in ("settings", "grid", "inputs")}
    for name, part in parts.items():
        if not isinstance(part, dict):
            raise InputError(f"{label}: {name} = {str(part)[:40]!r}; expected a table.")
    names = [*parts["settings"], *parts["grid"], *parts["inputs"]]
    settings = settings_of(verb)
    for name in names:
        if name not in settings and not _is_in_table(name, settings, parts["grid"]):
            expected = ", ".join(settings)
            raise InputError(f"{label}: {name} is no setting of {kind}. Expected {expected}.")
        if names.count(name) > 1:
            raise InputError(f"{label}: {name} is set twice. Set it in one place.")
    for name, setting in settings.items():
        if name not in names:
            setting.check(setting.default, f"{label}: {name}")
    for name, value in parts["settings"].items():
        settings[name].check(value, f"{label}: {name}")
    grid = {
        name: _values(settings[name.partition(".")[0]], name, value, label)
        for name, value in parts["grid"].items()
    }
    for name, source in parts["inputs"].items():
        _require_maker(verb, name, source, known, label)
    return _Entry(called, label, kind, verb, parts["settings"], grid, parts["inputs"])


def _is_in_table(name: str, settings: Mapping[str, Setting], grid: Mapping[str, Any]) -> bool:
    """Returns whether a grid's name, such as set.latency, is of a value in a table."""
    table, _, inner = name.partition(".")
    holds_table = isinstance(getattr(settings.get(table), "default", None), dict)
    return bool(inner) and name in grid and holds_table


def _put(settings: dict[str, Any], point: Mapping[str, Any]) -> dict[str, Any]:
    """Returns settings at a point of a grid."""
    values = dict(settings)
    for name, value in point.items():
        table, dot, inner = name.partition(".")
        values[table] = {**values.get(table, {}), inner: value} if dot else value
    return values


def _values(setting: Setting, name: str, values: Any, label: str) -> list[Any]:
    """The values of an axis: a list, or whole numbers from a first one on."""
    if isinstance(values, dict) and values.keys() == {"first", "count"}:
        first, count = values["first"], values["count"]
        if type(first) is int and type(count) is int and 1 <= count <= MAX_TASKS:
            values = list(range(first, first + count))
    if not isinstance(values, list) or not values:
        raise InputError(
            f"{label}: grid {name} = {str(values)[:60]}; expected a list of values, or "
            "{ first = 0, count = 10 }."
        )
    inner = name.partition(".")[2]
    for value in values:
        setting.check({inner: value} if inner else value, f"{label}: {name}")
    if len({json.dumps(value) for value in values}) < len(values):
        raise InputError(f"{label}: grid {name} has a value twice. Give each once.")
    return values


def _require_maker(
    verb: type[Verb], name: str, source: Any, known: Mapping[str, _Entry], label: str
) -> None:
    if not isinstance(source, str) or source not in known:
        raise InputError(
            f"{label}: input {name} = {source!r}; expected the name of an entry above it"
            f"{': ' + ', '.join(known) if known else ''}."
        )
    makers = {
        name: setting.producer for name, setting in settings_of(verb).items() if setting.producer
    }
    if name not in makers:
        maker_names = ", ".join(makers) or "no setting"
        raise InputError(
            f"{label}: no task makes {name} of {verb.name}; tasks make {maker_names}. "
            "Give it in settings."
        )
    if known[source].kind != makers[name]:
        raise InputError(
            f"{label}: input {name} is made by {source!r}, which is {known[source].kind}; "
            f"expected a task that is {makers[name]}."
        )


def _expanded(
    entry: _Entry,
    tasks_by_part: Mapping[str, Sequence[Task]],
    digests: dict[str, list[str]],
    devices: tuple[int, int],
) -> list[Task]:
    """The tasks of an entry: each point of its inputs, each point of its grid."""
    joined: list[tuple[dict[str, Any], dict[str, str]]] = [({}, {})]
    for name, source in entry.inputs.items():
        joined = [
            ({**point, **task.point}, {**keys, name: task.key})
            for point, keys in joined
            for task in tasks_by_part[source]
            if all(point.get(axis, value) == value for axis, value in task.point.items())
        ]
    if len(joined) * math.prod(map(len, entry.grid.values())) > MAX_TASKS:
        raise InputError(f"{entry.label}: more than {MAX_TASKS} tasks. Make several studies of it.")
    own = [
        dict(zip(entry.grid, values, strict=True))
        for values in itertools.product(*entry.grid.values())
    ]
    defaults = {
        name: plain(setting.default)
        for name, setting in settings_of(entry.verb).items()
        if name not in entry.inputs and setting.default is not REQUIRED
    }
    selection = []
    for at in own:
        settings = _put({**defaults, **entry.settings}, at)
        selection.append((at, settings, _content(entry, settings, digests)))
    tasks = []
    for point, keys in joined:
        for at, settings, content in selection:
            swept = {**point, **{f"{entry.name}.{name}": value for name, value in at.items()}}
            named = [entry.kind, entry.verb.version, __version__, content, keys, devices]
            key = hashlib.sha256(json.dumps(named, sort_keys=True).encode()).hexdigest()[:20]
            tasks.append(Task(entry.name, entry.kind, settings, swept, keys, key))
    return tasks


def _content(
    entry: _Entry, settings: dict[str, Any], digests: dict[str, list[str]]
) -> dict[str, Any]:
    """The settings by which a result is named: with the content of files that they name."""
    content = dict(settings)
    for name, setting in settings_of(entry.verb).items():
        value = settings.get(name)
        if setting.files and value is not None:
            values = value if isinstance(value, list) else [value]
            content[name] = [
                [value, _digests(value, f"{entry.label}: {name}", digests)] for value in values
            ]
    try:
        verb = entry.verb.from_settings({**settings, **dict.fromkeys(entry.inputs, PENDING)})
        verb.check_early()
        verb.check()
    except InputError as error:
        raise InputError(f"{entry.label}: {error}") from error
    return content


def _digests(value: str, label: str, known: dict[str, list[str]]) -> list[str]:
    """Digests of files that a setting names, if any: files, folders, and drones behind @."""
    if value not in known:
        # A name that is too long for a file system is there as little as any other.
        parts = [value] if os.path.exists(value) else re.split("[@+]", value)[:2]
        files = []
        for part in map(Path, parts):
            if os.path.isdir(part):
                files += sorted(path for path in part.rglob("*") if path.is_file())
            elif os.path.isfile(part):
                files.append(part)
                # A policy of Stable-Baselines3, and the scaling of its observations beside it.
                files += sorted(part.parent.glob("*.pkl")) if part.suffix == ".zip" else ()
            elif part.suffix in (".toml", ".json", ".csv"):
                raise InputError(f"{label} = {value!r}: no file {part} in the study's folder.")
        known[value] = [f"{path.name} {results.digest(path)}" for path in files]
    return known[value]
