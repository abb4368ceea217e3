"""Figures as files: the same bytes each time, escaped, and legible in light and in dark."""

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from maidenflight.parameters import COMPONENTS
from maidenflight.reporting import text
from maidenflight.reporting.figures import charts
from maidenflight.reporting.figures.charts import Entry, Figure
from maidenflight.reporting.figures.corner import corner
from maidenflight.reporting.figures.picture import svg
from maidenflight.reporting.figures.training import SCORES

EVIL = '"><script>alert(1)</script>&'
X, Y = charts.number("x", "time [s]"), charts.number("y", "distance [cm]")
LINE = {"mark": {"type": "line", "clip": True, "color": charts.paint("blue")}}


def figure(title: str = "Made up", panels: int = 2) -> Figure:
    data = charts.table({"x": [0.0, 1.0, 2.0], "y": [1.0, float("nan"), 300000.0], "series": "aaa"})
    panel = charts.panel(data, [{**LINE, "encoding": {"x": X, "y": Y}}], title=EVIL)
    legend = [Entry(EVIL, "orange", sample) for sample in ("line", "dot", "area", "dashed")]
    return Figure(title, [panel] * panels, legend)


def test_the_same_figure_gives_the_same_bytes_whatever_was_drawn_before() -> None:
    first = svg(figure())
    svg(corner({"mass": np.linspace(0.02, 0.03, 9), "latency": np.linspace(0.01, 0.02, 9)}))
    assert svg(figure()) == first


def test_a_picture_is_as_wide_as_it_should_be_and_nothing_in_it_is_markup() -> None:
    for panels, width in ((1, 400), (2, 920), (3, 700)):
        drawn = ElementTree.fromstring(svg(figure(EVIL, panels), width))
        assert abs(int(drawn.attrib["width"]) - width) <= panels
        assert drawn.attrib["aria-label"] == EVIL
        assert not list(drawn.iter("{http://www.w3.org/2000/svg}script"))
        texts = [
            "".join(part.itertext()) for part in drawn.iter("{http://www.w3.org/2000/svg}text")
        ]
        assert texts.count(EVIL) == 1 + panels + 4


def test_colours_are_light_ones_that_the_files_own_style_exchanges_in_the_dark() -> None:
    drawn = svg(figure())
    assert "var(--" not in drawn
    [style] = re.findall(r"<style>@media \(prefers-color-scheme: dark\) \{(.*?)\}</style>", drawn)
    exchanged = dict(re.findall(r'\[(?:fill|stroke)="(#\w+)"\]\{\w+:(#\w+)\}', style))
    used = set(re.findall(r'(?:fill|stroke)="(#\w+)"', drawn.replace(style, "")))
    assert used <= exchanged.keys()
    assert exchanged["#0067a5"] == "#5bb4ee"
    assert exchanged["#ffffff"] == "#14171b", "the ground"


def test_a_note_stands_below_the_title_in_lines() -> None:
    assert "in which" in svg(figure(), 400, "a note of several lines, " * 6 + "in which")


def test_the_gallery_shows_what_is_drawn_and_said_today() -> None:
    """Rebuild it by benchmarks/gallery.py: a demo takes minutes, its names and titles none."""
    folder = Path(__file__).parents[3] / "docs" / "gallery"
    shown = {path.stem: path.read_text() for path in folder.glob("*.svg")}
    names = [text.label(name) for name in COMPONENTS]
    assert sum(f">{name}<" in shown["identification"] for name in names) >= 10
    assert "Posterior of the delays" in shown["delays"]
    assert all(f">{label}<" in shown["learning"] for label, _ in SCORES.values())
    assert "tests&#160;pass&#160;in&#160;every&#160;log" in shown["log"]
    assert not any(re.search(r"\b(near|virtual|far)-\d", one) for one in shown.values())
