"""`Report`: one page of a run, or of several."""

from contextlib import suppress
from pathlib import Path
from typing import Any

from maidenflight import run_folder
from maidenflight.inputs import StrPath
from maidenflight.settings import path, setting, several
from maidenflight.verb import Output, Progress, Result, Verb

_MARK = b"<footer>Written by maidenflight "
"""What every report holds."""


def _file(help: str) -> Any:
    return setting(path(), None, help, files=True)


class Report(Verb):
    """Make one HTML page of a RUN, or of several.

    RUN is a folder with run.json, which commands write beside their output, or a file or folder
    that it lists; this folder by default. Files that are renamed, moved or by others are named by
    options, with or without a RUN.
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
    drone: Path | None = _file("Identified drone (TOML).")
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

    def may_replace(self, place: Path) -> bool:
        """Returns whether an earlier report is there."""
        with suppress(OSError):
            return place.is_file() and _MARK in place.read_bytes()
        return False

    @property
    def _files(self) -> Any:
        names = ("logs", "drone", "truth", "policies", "flights", "validation", "prediction")
        options = {name: getattr(self, name) for name in (*names, "study")}
        return {name: value for name, value in options.items() if value}

    def _find_source(self) -> Path | None:
        """Returns the only run; the folder it stands in where neither a run nor a file is named."""
        if len(self.runs) > 1:
            return None
        return next(iter(self.runs), None if self._files else Path())

    def compute(self, output: Path, progress: Progress) -> Result:
        """Writes the page."""
        from maidenflight.reporting.page import report, report_comparison

        progress.move(0, None, "reading the run")
        if len(self.runs) > 1:
            page = report_comparison(self.runs, output, **self._files)
        else:
            page = report(self._find_source(), output, **self._files)
        return Result(
            content={"report": str(page)},
            summary=[f"written {page}; open it in a browser"],
            value=page,
        )
