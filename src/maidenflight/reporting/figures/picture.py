"""Figures as files: SVG of the same specifications that the page draws, in light and in dark.

Colours are plain attributes, light ones, so that every program shows them; where a reader's system
is dark a style sheet within the file exchanges them.
"""

import json
import re
import textwrap
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import vl_convert
from markupsafe import escape

from maidenflight.reporting.figures.charts import NARROW, Entry, Figure, Spec
from maidenflight.reporting.html import asset

WIDTH = 920
"""Of a picture, by default [px]."""
_VEGA_LITE = "6.4"
"""The version that the page draws with."""
_FONT = "Liberation Sans, Arial, Helvetica, sans-serif"
"""The first comes with the converter, so that texts are measured as equally wide everywhere."""
_ROOM = 1.15
"""Room for a text over its width in this font: a reader may have only wider ones, as DejaVu's."""
_LACKING = dict(zip("⁻⁰⁴⁵⁶⁷⁸⁹", "¯º¤¥¦§¨©", strict=True))
"""Letters that the font lacks, and others that are measured in their place, lest widths depend on
which fonts a machine has."""
_LETTER = 7.4
"""About the width of a letter of the legend [px]."""
_LINE = 22
"""Height of a line of the legend [px]."""
_PADDING = 12
_SPACE = 22
"""Between panels [px]."""
_LEFT_OUT = ("params", "tooltip")
"""Parts of a specification that a picture does not answer to."""
_OWN = ("color", "shape", "size", "strokeDash", "strokeWidth", "opacity", "yOffset", "xOffset")
"""Channels whose scales panels do not share."""


def svg(figure: Figure, width: int = WIDTH, note: str = "") -> str:
    """Returns a figure as an SVG file. The same figure gives the same bytes.

    Args:
        figure: what is drawn.
        width: of the picture [px]; another where all panels have widths of their own.
        note: below the title.
    """
    columns = figure.columns or max(1, min(len(figure.panels), width // figure.least))
    each = (width - 2 * _PADDING - (columns - 1) * _SPACE) / columns
    kind = "narrow" if each < NARROW else "wide"
    figure = replace(figure, panels=[_chosen(panel, kind) for panel in figure.panels])
    # Axes take what their numbers and names need, which is known once they are drawn.
    inner = int(each) - 50
    # Letters of the title are larger and bold.
    words = [textwrap.wrap(figure.title, int(width / 1.5 / _LETTER))]
    words.append(textwrap.wrap(note, int(width / _LETTER)))
    picture = _drawn(figure, words, columns, inner)
    [size] = re.findall(r'^<svg [^>]*? width="(\d+)"', picture)
    if any("width" not in panel for panel in figure.panels if "layer" in panel):
        picture = _drawn(figure, words, columns, inner + (width - int(size)) // columns)
    return _in_light_and_dark(picture, figure.title)


def on_paper(svg: str, width_mm: float) -> str:
    """Returns an SVG file that is so wide on paper [mm]; what it shows stays."""
    [(width, height)] = re.findall(r'^<svg [^>]*? width="(\d+)" height="(\d+)"', svg)
    size = [width_mm * 72 / 25.4 * int(side) / int(width) for side in (width, height)]
    old = f' width="{width}" height="{height}"'
    return svg.replace(old, f' width="{size[0]:.2f}pt" height="{size[1]:.2f}pt"', 1)


def _chosen(part: Any, kind: str) -> Any:
    """A copy of a specification with what `charts.by_width` has for a phone or a wide page."""
    if isinstance(part, list | tuple):
        return [_chosen(each, kind) for each in part]
    if not isinstance(part, dict):
        return part
    if "narrow" in part:
        return _chosen(part[kind], kind)
    return {name: _chosen(each, kind) for name, each in part.items()}


def _drawn(figure: Figure, words: Sequence[list[str]], columns: int, inner: int) -> str:
    panels = [{"width": inner, **panel} if "layer" in panel else panel for panel in figure.panels]
    resolve = {"scale": dict.fromkeys(_OWN, "independent")}
    grid = {"concat": panels, "columns": columns, "align": "each", "spacing": _SPACE}
    grid["resolve"] = resolve
    parts = [_legend(figure.legend, columns * inner), grid] if figure.legend else [grid]
    look = json.loads(asset("look.json"))["config"]
    look |= {"background": _colours()[0]["paper"], "font": _FONT, "padding": _PADDING}
    look["aria"] = False
    # In a grid the page's expressions of a panel's size mean nothing.
    look["axisX"]["tickCount"] = max(2, inner // 70)
    del look["axisY"]["tickCount"]
    title = {"text": words[0], "fontSize": 17, "offset": 10}
    below = {"subtitle": words[1], "subtitleColor": "var(--soft)", "subtitlePadding": 6}
    below |= {"subtitleFontSize": 13, "subtitleLineHeight": 18}
    title |= below if words[1] else {}
    spec = {"title": title, "vconcat": parts, "config": look}
    spec |= {"spacing": 14, "resolve": resolve}
    svg = vl_convert.vegalite_to_svg(_plain(spec, columns * inner), vl_version=_VEGA_LITE)
    return _restore_characters(svg)


def _restore_characters(svg: str) -> str:
    """The same with letters in their size, and clips that count in a picture, not in a process.

    Raised letters that the font lacks are its own, raised and smaller.
    """
    svg = svg.translate({ord(other): lacking for lacking, other in _LACKING.items()})
    svg = re.sub(r">([^<>]+)<", lambda words: f">{_raised(words[1])}<", svg)
    clips = list(dict.fromkeys(re.findall(r'id="(clip\d+)"', svg)))
    numbers = {name: f"clip{number}" for number, name in enumerate(clips, 1)}
    svg = re.sub(r"\bclip\d+\b", lambda name: numbers.get(name[0], name[0]), svg)
    size = r'font-size="([\d.]+)px"'
    return re.sub(size, lambda size: f'font-size="{float(size[1]) / _ROOM:g}px"', svg)


def _raised(words: str) -> str:
    """A text of an SVG in which raised letters are smaller ones of the line, raised."""
    raised, plain = "".join(_LACKING) + "¹²³", "-0456789123".replace("-", "\N{MINUS SIGN}")
    letters = str.maketrans(raised, plain)

    def part(found: re.Match[str]) -> str:
        up = f'<tspan dy="-0.45em" font-size="0.7em">{found[1].translate(letters)}</tspan>'
        return f'{up}<tspan dy="0.315em">{found[2]}</tspan>' if found[2] else up

    return re.sub(rf"([{raised}]+)([^{raised}]*)", part, words)


def _legend(entries: Sequence[Entry], width: float) -> Spec:
    """The legend's entries side by side, in lines of a width."""
    samples, rows, across, line = json.loads(asset("look.json"))["samples"], [], 0.0, 0
    for entry in entries:
        entry_width = 30 + len(entry.name) * _LETTER
        if across > 0 and across + entry_width > width:
            across, line = 0.0, line + 1
        sample = {"width": 2, "dash": [1, 0], "fill": 0, **samples[entry.sample]}
        row = {"x": across, "name": entry.name, "colour": f"var(--{entry.colour})"}
        rows.append({**row, "y": line * _LINE, "text_x": across + 30, **sample})
        across += entry_width + 18
    x, y = ({"field": axis, "type": "quantitative", "scale": None, "axis": None} for axis in "xy")
    as_it_is: dict[str, Any] = {"scale": None, "legend": None, "type": "nominal"}
    encoding = {"x": x, "y": y, "shape": {"field": "path", **as_it_is}}
    encoding |= {"stroke": {"field": "colour", **as_it_is}}
    encoding |= {"fill": {"field": "colour", **as_it_is}}
    encoding |= {"fillOpacity": {"field": "fill", **as_it_is, "type": "quantitative"}}
    encoding |= {"strokeWidth": {"field": "width", **as_it_is, "type": "quantitative"}}
    encoding |= {"strokeDash": {"field": "dash", **as_it_is}}
    # Paths of the size 4 have the lengths that they say.
    sample = {"mark": {"type": "point", "size": 4, "opacity": 1}, "encoding": encoding}
    word = {"type": "text", "align": "left", "baseline": "middle", "dy": 6, "fontSize": 13}
    words = {"x": {**x, "field": "text_x"}, "y": y, "text": {"field": "name"}}
    return {
        "data": {"values": rows},
        "view": {"stroke": None},
        "width": 1,
        "height": _LINE * line + 12,
        "layer": [sample, {"mark": word, "encoding": words}],
    }


def _plain(part: Any, width: float) -> Any:
    """A copy with data in rows, sizes in pixels and light colours, without what answers."""
    if isinstance(part, list | tuple):
        return [_plain(each, width) for each in part]
    if isinstance(part, str):
        part = re.sub(r"var\(--(\w+)\)", lambda name: _colours()[0][name[1]], part)
        return part.translate(str.maketrans(_LACKING))
    if not isinstance(part, dict):
        return part
    if "share" in part:
        return max(24, int(width / part["share"] - part["less"]))
    if "columns" in part and len(part) == 1:
        names, columns = list(part["columns"]), list(part["columns"].values())
        rows = (dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True))
        return {"values": [_plain(row, width) for row in rows]}
    plain = {name: _plain(each, width) for name, each in part.items() if name not in _LEFT_OUT}
    sizes = [name for name in plain if name.lower().endswith("fontsize")]
    return plain | {name: _ROOM * plain[name] for name in sizes}


def _in_light_and_dark(svg: str, title: str) -> str:
    light, dark = _colours()
    rules = "".join(
        f'[fill="{light[name]}"]{{fill:{shade}}}[stroke="{light[name]}"]{{stroke:{shade}}}'
        for name, shade in dark.items()
        if light[name] in svg
    )
    style = f"<style>@media (prefers-color-scheme: dark) {{{rules}}}</style>"
    head, end, rest = svg.partition(">")
    return f'{head} role="img" aria-label="{escape(title)}"{end}{style}{rest}\n'


@cache
def _colours() -> tuple[dict[str, str], dict[str, str]]:
    light, dark = re.findall(r":root \{(.*?)\}", asset("colours.css"), re.DOTALL)
    light, dark = (dict(re.findall(r"--(\w+): (#\w+);", part)) for part in (light, dark))
    return light, dark
