"""The report of a run: one HTML file that needs nothing else, neither a network nor a server."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from markupsafe import Markup

from maidenflight import __version__, results
from maidenflight.experiments.transfer import Transfer
from maidenflight.inputs import StrPath
from maidenflight.reporting import key_figures, lead, sections, viewer
from maidenflight.reporting import run as runs
from maidenflight.reporting.html import asset, render
from maidenflight.reporting.run import Run


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
    ("recorded", "Recorded flights", sections.recorded),
    ("reproduce", "Reproduce", sections.reproduce),
)
"""Anchor, title and content of the page's sections; an empty one is left out."""


def report(source: StrPath | Transfer, path: StrPath) -> Path:
    """Writes what came of a run as one self-contained HTML file. The same run gives the same bytes.

    Args:
        source: the folder of a run, whatever of it there is, or test flights.
        path: the HTML file.

    Returns:
        The path.

    Raises:
        InputError: nothing known in the folder, a file in it is broken, or the page cannot be
            written.
    """
    run = runs.of_transfer(source) if isinstance(source, Transfer) else runs.read(Path(source))
    return results.write(path, to_html(run))


def to_html(run: Run) -> str:
    """The page."""
    made = [Section(name, title, make(run)) for name, title, make in _SECTIONS]
    logs = viewer.held(run)
    scripts = ["page.js", *(["scene.js", "traces.js", "viewer.js"] if logs else [])]
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
        scripts=[asset(name) for name in scripts],
    )
    return f"{page}\n"


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
