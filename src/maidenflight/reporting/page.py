"""The report of a run: one HTML file that needs nothing else, neither a network nor a server."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, Unpack

from markupsafe import Markup

from maidenflight import __version__, results
from maidenflight.experiments.transfer import Transfer
from maidenflight.inputs import StrPath
from maidenflight.reporting import key_figures, lead, sections, viewer
from maidenflight.reporting import run as runs
from maidenflight.reporting.html import asset, render
from maidenflight.reporting.run import Run
from maidenflight.reporting.run_files import FileOptions


class Section(NamedTuple):
    """A part of the page: its anchor, its heading and what it shows."""

    name: str
    title: str
    content: Markup


_SECTIONS: tuple[tuple[str, str, Callable[[Run], Markup]], ...] = (
    ("parameters", "Parameters", sections.parameters),
    ("validation", "Prediction", sections.prediction),
    ("training", "Training", sections.training),
    ("predicted", "Predicted flight times", sections.predicted),
    ("flights", "Test flights", sections.flights),
    ("change", "Change in flight", sections.change),
    ("study", "Study", sections.study),
    ("recorded", "Recorded flights", sections.recorded),
    ("reproduce", "Reproduce", sections.reproduce),
)
"""Anchor, title and content of the page's sections; an empty one is left out."""


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
            nothing where files are given.
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
        return results.write(path, to_html(runs.read(source, files)))
    flown = runs.of_transfer(source)
    if files:
        flown = replace(runs.read(None, files), table=flown.table, flights=flown.flights)
    return results.write(path, to_html(flown))


def to_html(run: Run) -> str:
    """The page."""
    made = [Section(name, title, make(run)) for name, title, make in _SECTIONS]
    logs = viewer.held(run)
    drawn = any("<figure class=chart " in section.content for section in made)
    scripts = [asset("page.js")]
    scripts += [asset(name) for name in _VIEWER] if logs else []
    scripts += [*vega(), asset("charts.js")] if drawn else []
    page = render(
        "page.html",
        title=lead.title(run),
        badge=lead.kind(run),
        lead=lead.lead(run),
        figures=key_figures.key_figures(run),
        sections=[section for section in made if section.content],
        version=__version__,
        style=asset("colours.css") + _themes() + asset("style.css"),
        logs=_json(logs) if logs else "",
        scripts=scripts,
    )
    return f"{page}\n"


def vega() -> list[Markup]:
    """The scripts of Vega; its interpreter of expressions, a module, as a plain script.

    With the interpreter no text is ever run as a script, which the page does not allow.
    """
    module = str(asset("vega/vega-interpreter.js"))
    for line, plain in _MODULE.items():
        assert line in module, line
        module = module.replace(line, plain)
    return [asset("vega/vega.min.js"), asset("vega/vega-lite.min.js"), Markup(f"{{\n{module}\n}}")]


def _json(content: Any) -> Markup:
    """Content as JSON within a script element: nothing in it can end the element."""
    text = json.dumps(content, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return Markup(text.replace("<", "\\u003c"))


def _themes() -> Markup:
    """Light and dark again, for those who choose another than their system has.

    Print is always light.
    """
    light, dark = re.findall(r":root \{(.*?)\}", asset("colours.css"), re.DOTALL)
    return Markup(
        f":root[data-theme=light] {{{light}  color-scheme: light;\n}}\n"
        f"@media screen {{ :root[data-theme=dark] {{{dark}  color-scheme: dark;\n}} }}\n"
    )
