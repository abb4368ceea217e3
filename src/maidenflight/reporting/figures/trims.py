"""The picture of what single flights say: thrust, trims and battery over the flights' number."""

from collections.abc import Mapping

import numpy as np
import polars

from maidenflight.identification.drone_file import Estimate
from maidenflight.reporting.figures import charts
from maidenflight.reporting.figures.charts import Entry, Figure, Spec

_DISPLAY_FORMATS = {
    "thrust_to_weight": ("thrust-to-weight ratio", 1.0, 0.02),
    "hover_command": ("hover command [% of full thrust]", 100.0, 1.0),
    "torque_bias_x": ("torque bias x [10⁻⁶ N m]", 1e6, 0.0),
    "torque_bias_y": ("torque bias y [10⁻⁶ N m]", 1e6, 0.0),
    "torque_bias_z": ("torque bias z [10⁻⁶ N m]", 1e6, 0.0),
    "battery": ("battery [V]", 1.0, 0.1),
}
"""Label, displayed value per SI value, and least span of the axis: 1 % of a hover command and 0.1 V
are what flights of one drone differ by."""


def trims(
    flights: polars.DataFrame,
    estimates: Mapping[str, Estimate] | None = None,
    chooses: bool = True,
) -> Figure:
    """Returns a panel a quantity, a dot a flight with its standard error.

    Args:
        flights: a row a flight, as `flight_tables.trims` gives them.
        estimates: of the drone that is identified, which are drawn across.
        chooses: see `Figure`.
    """
    formats = {
        name: format
        for name, format in _DISPLAY_FORMATS.items()
        if name in flights.columns and flights[name].cast(polars.Float64).is_finite().any()
    }
    identified = {name: estimate for name, estimate in (estimates or {}).items() if name in formats}
    panels = [
        _panel(flights, name, format, identified.get(name)) for name, format in formats.items()
    ]
    errors = any(f"{name}_error" in flights.columns for name in formats)
    legend = [Entry("flight, with its standard error" if errors else "flight", "blue", "dot")]
    if identified:
        legend.append(Entry("identified, 95 % interval", "orange", "line", "identified"))
    return Figure("Flight by flight", panels, legend, least=320, chooses=chooses)


def _panel(
    flights: polars.DataFrame,
    name: str,
    format: tuple[str, float, float],
    estimate: Estimate | None,
) -> Spec:
    label, scale, least = format
    values = scale * flights[name].cast(polars.Float64).to_numpy()
    error, width = f"{name}_error", np.full(len(values), np.nan)
    if error in flights.columns:
        width = scale * flights[error].cast(polars.Float64).to_numpy()
    rows: list[Spec] = [
        {"series": "flight", "x": number, "place": index, "name": flight, "y": value}
        | {"error": spread, "low": value - spread, "high": value + spread}
        for index, (number, flight, value, spread) in enumerate(
            zip(flights["number"], flights["flight"], values, width, strict=True)
        )
    ]
    if estimate is not None:
        low, high = estimate.interval
        ends = {"y": scale * estimate.value, "low": scale * low, "high": scale * high}
        rows.append({"series": "identified", "x": 1, **ends})
    x = charts.number(
        "x",
        "flight",
        scale={"zero": False, "nice": False, "padding": 8},
        axis={"tickMinStep": 1, "format": "d"},
    )
    in_view = [row[end] for row in rows for end in ("y", "low", "high")]
    span = charts.within(*charts.margin(in_view, least))
    y, across = charts.number("y", **span), charts.number("low", **span)
    tooltip = charts.tooltip({"name": "", "x": "flight", "y": label, "error": "± [ ]"})
    blue, orange = charts.paint("blue"), charts.paint("orange")
    flight, identified = "datum.series === 'flight'", "datum.series === 'identified'"
    dot = {"type": "point", "filled": True, "size": 34, "color": blue, "opacity": 1}
    bar = {"type": "rule", "color": blue, "opacity": 0.5}
    layers = [
        charts.layer(flight, bar, x=x, y=across, y2={"field": "high"}),
        charts.layer(flight, dot, x=x, y=y, tooltip=tooltip),
    ]
    if estimate is not None:
        band = {"type": "rect", "color": orange, "opacity": 0.2}
        line = {"type": "rule", "color": orange, "strokeWidth": 2}
        layers += [
            charts.layer(identified, band, y=across, y2={"field": "high"}),
            charts.layer(identified, line, y=y),
        ]
    return charts.panel(charts.rows(rows), layers, title=label, height=150)
