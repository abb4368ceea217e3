"""A line chart on logarithmic axes as SVG."""

from itertools import product

from maidenflight.reporting.figures import charts, picture
from maidenflight.reporting.figures.charts import Entry, Figure, Spec

STYLES = [
    (colour, sample) for colour, sample in product(("blue", "orange", "green"), ("line", "dashed"))
]
"""Of curves, in their order."""


def lines(curves: dict[str, dict[int, float]], across: str, up: str) -> str:
    """Curves by name, each positive values at positive places."""
    legend = [
        Entry(name, *STYLES[number % len(STYLES)], series=name)
        for number, name in enumerate(curves)
    ]
    rows: list[Spec] = [
        {"series": name, "x": place, "y": value}
        for name, curve in curves.items()
        for place, value in sorted(curve.items())
    ]
    places = sorted({place for curve in curves.values() for place in curve})
    powers = [10**power for power in range(16)]
    log = {"type": "log", "nice": False}
    x = charts.number("x", across, scale=log, axis={"values": places, "format": ","})
    y = charts.number("y", up, scale={"type": "log"}, axis={"format": "~s", "values": powers})
    strokes = [[7, 4] if entry.sample == "dashed" else [1, 0] for entry in legend]
    dashes = {"domain": list(curves), "range": strokes}
    layer: Spec = {
        "mark": {"type": "line", "strokeWidth": 2.5},
        "encoding": {
            "x": x,
            "y": y,
            "color": charts.coloured({entry.name: entry.colour for entry in legend}),
            "strokeDash": {"field": "series", "type": "nominal", "scale": dashes},
        },
    }
    panel = charts.panel(charts.rows(rows), [layer], height=350, zooms=())
    title = f"{up.capitalize()} against {across}"
    return picture.svg(Figure(title, [panel], legend), 760)
