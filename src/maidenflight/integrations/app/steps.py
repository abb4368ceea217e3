"""Steps of a run: what verbs have written in its folder, and what a form begins with."""

import zlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from maidenflight.integrations.app import folder as files
from maidenflight.integrations.app import forms
from maidenflight.integrations.app.jobs import Job
from maidenflight.manifest import Entry, Manifest
from maidenflight.run_folder import REPORT
from maidenflight.settings import REQUIRED, Setting
from maidenflight.verb import Verb


class Step(NamedTuple):
    """What is in the folder of a verb."""

    entries: Sequence[Entry]
    """The latest last."""
    names: Sequence[str]
    """Files that it wrote and that are still there."""
    archives: Sequence[str]
    """Folders among its outputs."""
    stamp: str
    """What changes with its results."""


def read_step(run: Manifest, name: str, job: Job | None = None) -> Step:
    """Returns what a verb wrote, as the manifest and its command say."""
    entries = [entry for entry in run.entries if entry.verb == name]
    named = [file for entry in entries for ones in entry.written.values() for file in ones]
    outputs = [word.partition("=")[2] for word in (job.words if job else ()) if "--output=" in word]
    named += [*outputs, *([REPORT] if name == "report" else [])]
    there = [file for file in dict.fromkeys(named) if (run.folder / file).is_file()]
    folders = {entry.output for entry in entries if (run.folder / entry.output).is_dir()}
    return Step(entries, there, sorted(folders), f"{zlib.crc32(repr(entries).encode()):08x}")


def find_logs(run: Manifest) -> str:
    """Returns where the logs of a run are: those that were dropped, else those that it recorded."""
    if files.find_logs(run.folder):
        return files.LOGS
    recorded = [entry.output for entry in run.entries if run.files(entry, "logs")]
    return recorded[-1] if recorded else ""


def suggest(run: Manifest, verb: type[Verb], jobs: Iterable[Job]) -> dict[str, list[str]]:
    """Returns what a form begins with: what verbs before it wrote and said, and what it ran by."""
    filled = {}
    for name, setting in forms.fields(verb).items():
        if setting.argument and (path := _find_place(run, name, setting)):
            filled[name] = [path]
    for job in sorted(jobs, key=lambda job: job.verb == verb.name):
        if job.verb == verb.name:
            filled |= forms.filled_by(verb, job.words)
        elif job.state == "done" and job.next[:1] == [verb.name]:
            filled |= forms.filled_by(verb, job.next[1:])
    return filled


def _find_place(run: Manifest, name: str, setting: Setting) -> str:
    if name == "logs":
        return find_logs(run) or files.LOGS
    kinds = (name, f"{name}s", f"{name.removesuffix('y')}ies")
    for entry in reversed(run.entries):
        if entry.verb == setting.producer:
            return entry.output
        for kind in kinds if setting.default is REQUIRED and not setting.producer else ():
            if entry.written.get(kind):
                return entry.written[kind][0]
    return ""


def find_files(folder: Path, run: Manifest) -> list[str]:
    """Lists names that a field may hold: outputs, tables of settings and logs."""
    logs = [f"{files.LOGS}/{name}" for name in files.find_logs(folder)]
    tables = [path.name for path in sorted(folder.glob("*.toml"))]
    return list(dict.fromkeys([*(entry.output for entry in run.entries), *tables, *logs]))
