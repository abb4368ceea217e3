"""`Report`: one page of a run, or of several."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from maidenflight import run_folder
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.settings import path, setting, several
from maidenflight.verb import Output, Progress, Result, Verb

_MARK = b"Written by maidenflight "
"""What every report holds."""


def _file(help: str) -> Any:
    return setting(path(), None, help, files=True)


class Report(Verb):
    """Make one HTML page of a RUN, or of several.

    RUN is a folder with run.json, which commands write beside their output, a file or folder that
    it lists, or any drone file; this folder by default. NAME=RUN names one of several on the page.
    Files that are renamed, moved or by others are named by options, with or without a RUN.
    """

    in_studies = False
    output = Output(None, "HTML file; report.html by default, in the folder where RUN is one.")

    runs: tuple[Path, ...] = setting(
        several(path("a run"), empty=True), (), argument=True, files=True, name="run"
    )
    logs: tuple[Path, ...] = setting(
        several(path(), empty=True),
        (),
        "Flight logs of any format that identify reads, a file or a folder; may be repeated.",
        "Other files",
        files=True,
    )
    drone: tuple[Path, ...] = setting(
        several(path(), empty=True),
        (),
        "Identified drone (TOML); several are compared.",
        files=True,
    )
    truth: Path | None = _file("Parameters of the virtual drone that was recorded (TOML).")
    policies: Path | None = _file("Policy or folder of policies.")
    flights: Path | None = _file("Table of test flights; logs flight_*.csv beside it count too.")
    validation: Path | None = _file("Table of prediction errors.")
    prediction: Path | None = _file("Table of predicted flights.")
    study: Path | None = _file("Table of a study.")

    def choose_output(self, output: StrPath | None) -> Path:
        """Returns the page."""
        if output is not None:
            return Path(output)
        folder = self._find_source()
        return (folder if folder is not None and folder.is_dir() else Path()) / run_folder.REPORT

    def may_replace(self, path: Path) -> bool:
        """Returns whether an earlier report is there."""
        with suppress(OSError):
            return path.is_file() and _MARK in path.read_bytes()
        return False

    @property
    def _files(self) -> Any:
        names = ("logs", "drone", "truth", "policies", "flights", "validation", "prediction")
        options = {name: getattr(self, name) for name in (*names, "study")}
        options["drone"] = next(iter(self.drone), None)
        return {name: value for name, value in options.items() if value}

    def _find_source(self) -> Path | None:
        """Returns the only run; the folder it stands in where neither a run nor a file is named."""
        if len(self.runs) > 1 or len(self.drone) > 1:
            return None
        return next(iter(self.runs), None if self._files else Path())

    def _name_runs(self) -> Sequence[Path] | Mapping[str, Path]:
        """Returns the runs that are compared, by their names where any has one."""
        if len(self.drone) > 1:
            if self.runs:
                raise InputError(
                    f"{self.drone[0]} and {self.drone[1]}: two drones beside a RUN; expected one. "
                    "Give either runs or drones to compare."
                )
            return self.drone
        runs_by_name: dict[str, Path] = {}
        for run in self.runs:
            name, sign, rest = str(run).partition("=")
            name, path = (str(run), run) if run.exists() or not sign else (name, Path(rest))
            if name in runs_by_name:
                raise InputError(f"{run}: another run is named {name}. Give other names.")
            runs_by_name[name] = path
        return self.runs if set(runs_by_name.values()) == set(self.runs) else runs_by_name

    def compute(self, output: Path, progress: Progress) -> Result:
        """Writes the page."""
        from maidenflight.reporting.page import report, report_comparison

        progress.move(0, None, "reading the run")
        if max(len(self.runs), len(self.drone)) > 1:
            files = self._files if len(self.drone) < 2 else self._files | {"drone": None}
            page = report_comparison(self._name_runs(), output, **files)
        else:
            page = report(self._find_source(), output, **self._files)
        return Result(
            content={"report": str(page)},
            summary=[f"written {page}; open it in a browser"],
            value=page,
        )
