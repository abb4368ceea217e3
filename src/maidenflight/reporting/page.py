"""The report of a run: one HTML file that needs nothing else, neither a network nor a server.

The page's frame, style and scripts are the files beside this module.
"""

import re
from collections.abc import Callable
from html import escape
from importlib import resources
from pathlib import Path
from string import Template

from maidenflight import __version__, results
from maidenflight.experiments.transfer import Transfer
from maidenflight.inputs import StrPath
from maidenflight.reporting import key_figures, lead, records, sections, text, unshown, viewer
from maidenflight.reporting import run as runs
from maidenflight.reporting.run import Run

_SECTIONS: tuple[tuple[str, str, Callable[[Run], str]], ...] = (
    ("parameters", "Parameters", sections.parameters),
    ("validation", "Prediction", sections.prediction),
    ("training", "Training", sections.training),
    ("predicted", "Predicted flight times", sections.predicted),
    ("flights", "Test flights", sections.flights),
    ("recorded", "Recorded flights", sections.recorded),
    (
        "reproduce",
        "Reproduce",
        lambda run: records.seconds(run) + records.records(run) + unshown.told(run.unshown),
    ),
)
"""Anchor, title and content of the page's sections; one of which nothing is known is left out."""


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
    drawn = [(name, title, content) for name, title, make in _SECTIONS if (content := make(run))]
    held = viewer.held(run)
    scripts = ["page.js", *(["scene.js", "traces.js", "viewer.js"] if held else [])]
    return Template(_file("page.html")).substitute(
        title=escape(lead.title(run)),
        badge=f"<span class=badge>{lead.kind(run)}</span>" if lead.kind(run) else "",
        lead=lead.lead(run),
        figures=key_figures.key_figures(run),
        links="".join(f'<a href="#{name}">{title}</a>' for name, title, _ in drawn),
        sections="\n".join(
            f'<section id="{name}"><h2>{title}</h2>{content}</section>'
            for name, title, content in drawn
        ),
        version=__version__,
        style=_file("colours.css") + _themes() + _file("style.css"),
        content=text.embed("logs", held) if held else "",
        scripts="\n".join(f"<script>{_file(name)}</script>" for name in scripts),
    )


def _file(name: str) -> str:
    return resources.files("maidenflight.reporting").joinpath(name).read_text(encoding="utf-8")


def _themes() -> str:
    """Light and dark again, for those who choose another than their system has.

    Print is always light.
    """
    light, dark = re.findall(r":root \{(.*?)\}", _file("colours.css"), re.DOTALL)
    return (
        f":root[data-theme=light] {{{light}  color-scheme: light;\n}}\n"
        f"@media screen {{ :root[data-theme=dark] {{{dark}  color-scheme: dark;\n}} }}\n"
    )
