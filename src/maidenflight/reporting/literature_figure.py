"""The picture of identified parameters beside what others give for a Crazyflie."""

from collections.abc import Mapping

import numpy as np

from maidenflight.errors import InputError
from maidenflight.reporting import charts, literature, text
from maidenflight.reporting.charts import Entry, Figure, Spec
from maidenflight.reporting.delay_figures import Estimated

ROW = 30
"""Height of a parameter [px]."""
_STEPS = [2.0**power for power in range(-6, 7)]


def comparable(name: str) -> bool:
    """Whether the paper has a value above zero, of which a parameter can be shown as a multiple."""
    return literature.of_the_paper(name) > 0


def beside_literature(
    estimates: Mapping[str, Estimated], truth: Mapping[str, tuple[float, float]] | None = None
) -> Figure:
    """Identified parameters, each as a multiple of the paper's value, on one logarithmic axis.

    Args:
        estimates: by parameter; those that the paper's model lacks are left out.
        truth: from and to, by parameter, of a virtual drone [SI].

    Raises:
        InputError: none of the parameters has a value above zero in the paper.
    """
    shown = [name for name in estimates if comparable(name) and estimates[name].value > 0]
    if not shown:
        raise InputError(
            "no parameter to draw beside the literature: the paper gives none of them a value "
            "above zero."
        )
    rows: list[Spec] = []
    for name in shown:
        rows += _rows(name, estimates[name], (truth or {}).get(name))
    values = [row[end] for row in rows for end in ("x", "x2") if row.get(end) is not None]
    x = charts.number(
        "x",
        "multiple of the paper's value",
        scale={
            "type": "log",
            "base": 2,
            "domain": [min([0.85, *(0.94 * value for value in values)]), 1.06 * max(values)],
            "nice": False,
        },
        axis={
            "values": _STEPS,
            "labelExpr": "(datum.value < 1 ? '1/' + round(1 / datum.value) : datum.value)"
            " + '\N{MULTIPLICATION SIGN}'",
        },
    )
    order = [text.plain_symbol(name) for name in shown]
    y = {
        "field": "parameter",
        "type": "nominal",
        "sort": order,
        "title": None,
        "axis": {"ticks": False, "labelColor": charts.paint("ink"), "labelFontSize": 13},
    }
    told = {"name": "", "told": "value", "between": "95 % interval", "source": "source"}
    layers = [
        _layer("paper", {"type": "tick", "size": ROW, "thickness": 2}, "purple", x, y, told),
        _layer("others", {"type": "point", "filled": True, "size": 40}, "soft", x, y, told),
        _layer("truth", {"type": "rule", "strokeWidth": 2}, "green", x, y, {}),
        _layer("truth", {"type": "tick", "size": 18, "thickness": 2}, "green", x, y, told),
        _layer("identified", {"type": "rule", "strokeWidth": 3}, "orange", x, y, {}),
        _layer("identified", {"type": "tick", "size": 10, "thickness": 3}, "orange", x, y, told),
    ]
    legend = [Entry("identified, 95 % interval", "orange", "plus", "identified")]
    legend += [Entry("truth", "green", "range", "truth")] if truth else []
    legend += [Entry("paper", "purple", "tick", "paper"), Entry("others", "soft", "dot", "others")]
    panel = charts.panel(charts.rows(rows), layers, height=ROW * len(shown) + 8, zooms=("x",))
    return Figure("Beside the literature", [panel], legend)


def _rows(name: str, found: Estimated, truth: tuple[float, float] | None) -> list[Spec]:
    """What is drawn of a parameter; each value as a multiple of the paper's."""
    paper, unit = literature.of_the_paper(name), text.unit(name)

    def said(value: float) -> str:
        return f"{text.number(value * text.factor(name))} {unit}".rstrip()

    common = {"parameter": text.plain_symbol(name), "name": name.replace("_", " ")}
    low, high = found.interval
    rows: list[Spec] = [
        {"series": "paper", "x": 1.0, "told": said(paper), "source": literature.PAPER, **common}
    ]
    rows += [
        {"series": "others", "x": each.value / paper, "told": said(each.value), **common}
        | {"source": each.source}
        for each in literature.published(name)
    ]
    if truth is not None and min(truth) > 0:
        first, last = truth
        for value in dict.fromkeys((first, last)):
            row = {"series": "truth", "x": value / paper, "x2": last / paper, "told": said(value)}
            rows.append(row | {"source": "the virtual drone", **common})
    ends_shown = [text.factor(name) * end for end in (low, high)]
    digits = text.places(ends_shown[1] - ends_shown[0])
    interval = {"between": " .. ".join(f"{end:.{digits}f}" for end in ends_shown) + f" {unit}"}
    centre = {"series": "identified", "x": found.value / paper, "told": said(found.value)}
    rows.append({**centre, **interval, "source": "these flights", **common})
    ends = np.maximum([low, high], 1e-3 * found.value) / paper
    rows.append({"series": "identified", "x": ends[0], "x2": ends[1], "line": True, **common})
    return rows


def _layer(series: str, mark: Spec, colour: str, x: Spec, y: Spec, told: Mapping[str, str]) -> Spec:
    """Marks of a series; a rule has two ends, and of `identified` a row of its own."""
    rule = mark["type"] == "rule"
    lines = "isValid(datum.line)" if rule else "!isValid(datum.line)"
    only = f" && {lines}" if series == "identified" else ""
    encoding: Spec = {"x": x, "y": y}
    encoding |= {"x2": {"field": "x2"}} if rule else {"tooltip": charts.tooltip(told)}
    return {
        "transform": [{"filter": f"datum.series === '{series}'{only}"}],
        "mark": {**mark, "color": charts.paint(colour), "opacity": 1},
        "encoding": encoding,
    }
