"""The report of a run: one HTML file that needs nothing else, neither a network nor a server."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, Unpack

from markupsafe import Markup

from maidenflight import __version__, results, run_folder
from maidenflight.errors import InputError
from maidenflight.experiments.policies import shortest_names
from maidenflight.experiments.transfer import Transfer
from maidenflight.inputs import StrPath
from maidenflight.reporting import run as runs
from maidenflight.reporting import viewer
from maidenflight.reporting.figures.charts import embedded
from maidenflight.reporting.html import asset, render, sendable, style
from maidenflight.reporting.run import Run
from maidenflight.reporting.run_files import FileOptions
from maidenflight.reporting.sections import (
    comparison,
    flights,
    head,
    parameters,
    predictions,
    reproduce,
    study,
    training,
)


class Section(NamedTuple):
    """A part of the page: its anchor, its heading and what it shows."""

    name: str
    title: str
    content: Markup


SECTIONS: tuple[tuple[str, str, Callable[[Run], Markup]], ...] = (
    ("recorded", "Recorded flights", flights.recorded),
    ("parameters", "Parameters", parameters.section),
    ("validation", "Prediction", predictions.section),
    ("training", "Training", training.section),
    ("predicted", "Predicted flight times", flights.predicted),
    ("flights", "Test flights", flights.tested),
    ("change", "Change in flight", flights.change),
    ("study", "Study", study.section),
    ("reproduce", "Reproduce", reproduce.section),
)
"""Anchor, title and content of the page's sections; an empty one is left out."""
_COMPARED: tuple[tuple[str, str, Callable[[comparison.Runs], Markup]], ...] = (
    ("figures", "Key figures", comparison.key_figures),
    ("parameters", "Parameters", comparison.parameters),
    ("training", "Training", comparison.trained),
    ("predicted", "Predicted flight times", comparison.predicted),
    ("flights", "Test flights", comparison.tested),
)
"""The same of the page of several runs."""


_VIEWER = ("scene.js", "traces.js", "viewer.js")
_MODULE = {
    "import { ascending, isString, DisallowedObjectProperties } from 'vega-util';": "const { "
    "ascending, isString, DisallowedObjectProperties } = vega;",
    "export { expression as expressionInterpreter };": "vega.expressionInterpreter = expression;",
    "//# sourceMappingURL=vega-interpreter.js.map": "",
}
"""What makes the module a plain script."""


def report(source: StrPath | Transfer | None, path: StrPath, **files: Unpack[FileOptions]) -> Path:
    """Writes what came of a run as one self-contained HTML file. The same run gives the same bytes.

    Args:
        source: the folder of a run, a file or folder that its `run.json` lists, test flights, or
            nothing where options name files.
        path: the HTML file.
        **files: files of any name and place, in place of those of the run: `logs` (one or several,
            of any format that `identify` reads), `drone`, `truth`, `policies`, `flights`,
            `validation`, `prediction`, `study`; see `FileOptions`.

    Returns:
        The path.

    Raises:
        InputError: nothing of a run is there, a file is broken, or the page cannot be written.
    """
    if not isinstance(source, Transfer):
        return results.write(path, to_html(runs.read_run(source, files)))
    run = runs.of_transfer(source)
    if files:
        run = replace(runs.read_run(None, files), table=run.table, flights=run.flights)
    return results.write(path, to_html(run))


def report_comparison(
    sources: Sequence[StrPath] | Mapping[str, StrPath],
    path: StrPath,
    **files: Unpack[FileOptions],
) -> Path:
    """Writes several runs side by side as one self-contained HTML file.

    Args:
        sources: two runs or more, each as in `report`, perhaps by names for the page.
        path: the HTML file.
        **files: files to take of every run; see `report`.

    Returns:
        The path.

    Raises:
        InputError: see `report`; or the runs have nothing in common.
    """
    if not isinstance(sources, Mapping):
        # Of drone.toml its folder is the name.
        places = [Path(source) for source in sources]
        paths = [
            (path.parent if path.name == run_folder.DRONE else path).resolve() for path in places
        ]
        if len(set(paths)) < len(paths):
            raise InputError(f"{places[0]}: the same run twice; give others to compare.")
        sources = dict(zip(shortest_names(paths), places, strict=True))
    compared = {name: runs.read_run(source, files) for name, source in sources.items()}
    sections = [Section(name, title, make(compared)) for name, title, make in _COMPARED]
    content = {
        "title": " beside ".join(compared),
        "badge": "",
        "lead": comparison.summarize(compared),
        "judgements": [],
        "figures": [],
    }
    return results.write(path, _render(content, sections))


def to_html(run: Run) -> str:
    """Returns the page."""
    sections = [Section(name, title, make(run)) for name, title, make in SECTIONS]
    content = {
        "title": head.title(run),
        "badge": head.kind(run),
        "lead": head.summarize(run),
        "judgements": head.judgements(run),
        "figures": head.key_figures(run),
    }
    return _render(content, sections, viewer.viewer_data(run))


def _render(content: Mapping[str, Any], sections: Sequence[Section], logs: Any = None) -> str:
    has_charts = any("<figure class=chart " in section.content for section in sections)
    scripts = [asset("page.js")]
    scripts += [asset(name) for name in _VIEWER] if logs else []
    if has_charts:
        scripts += [*vega(), Markup(f"const LOOK = {asset('look.json')};"), asset("charts.js")]
    page = render(
        "page.html",
        **content,
        sections=[section for section in sections if section.content],
        version=__version__,
        style=style(),
        logs=embedded(logs) if logs else "",
        scripts=scripts,
    )
    return sendable(f"{page}\n")


def vega() -> list[Markup]:
    """Returns the scripts of Vega; its interpreter of expressions, a module, as a plain script.

    With the interpreter no text is ever run as a script, which the page does not allow.
    """
    module = str(asset("vega/vega-interpreter.js"))
    for line, plain in _MODULE.items():
        assert line in module, line
        module = module.replace(line, plain)
    return [asset("vega/vega.min.js"), asset("vega/vega-lite.min.js"), Markup(f"{{\n{module}\n}}")]
