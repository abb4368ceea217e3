"""Pictures of flights, identifications and policies, as notebooks show them."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import vl_convert

from maidenflight import results
from maidenflight.errors import InputError
from maidenflight.flights.log import Flight
from maidenflight.identification.drone_file import DroneFile
from maidenflight.identification.outcome.estimates import Identification
from maidenflight.identification.posterior import Posterior
from maidenflight.inputs import StrPath
from maidenflight.parameters import crazyflie
from maidenflight.policy import Actor, Policy
from maidenflight.reporting.figures import charts
from maidenflight.reporting.figures.charts import Entry, Figure, Spec
from maidenflight.reporting.figures.corner import corner
from maidenflight.reporting.figures.identification import estimates
from maidenflight.reporting.figures.picture import on_paper, svg
from maidenflight.simulator.physics.sensors import Measurement

_MOST_ROWS = 500
"""Rows of a line, at most."""
_OFFSETS = np.linspace(-0.5, 0.5, 21)
"""Distances to the set-point [m]."""


def _to_pdf(svg: str) -> bytes:
    """The converter writes a pixel as a point."""
    return vl_convert.svg_to_pdf(svg.replace('pt"', '"', 2))


def _to_png(svg: str) -> bytes:
    """300 dots an inch; the converter counts 96 pixels of an SVG as 72."""
    return vl_convert.svg_to_png(svg, scale=72 / 96, ppi=300)


_WRITERS: Mapping[str, Callable[[str], str | bytes]] = {
    ".svg": str,
    ".pdf": _to_pdf,
    ".png": _to_png,
}
"""What makes a file of an SVG, by its suffix."""


class Picture(NamedTuple):
    """A figure that a notebook shows, and that is written as a file."""

    figure: Figure

    def _repr_svg_(self) -> str:
        return svg(self.figure)

    def save(self, path: StrPath, width_mm: float | None = None) -> None:
        """Writes the picture as SVG, PDF or PNG, by the path's suffix.

        Args:
            path: of the file.
            width_mm: of the picture on paper [mm]. By default that of a column, 88, or of a page,
                180, where a panel needs more.

        Raises:
            InputError: the suffix is another, or the width is not above 0.
        """
        suffix = Path(path).suffix.lower()
        if suffix not in _WRITERS:
            raise InputError(f"{path}: a picture is written as {', '.join(_WRITERS)}. Rename it.")
        least = self.figure.least if self.figure.columns else 0
        # Letters of axes are then 7.5 pt high in a picture of any width.
        pixel_mm = 0.22
        column = 88.0 if least * pixel_mm <= 88.0 else 180.0
        width = column if width_mm is None else width_mm
        if not 0 < width < 2000:
            raise InputError(f"width_mm={width:g}: expected millimetres above 0, such as 88.")
        drawn = svg(self.figure, max(least, round(width / pixel_mm)))
        results.write(path, _WRITERS[suffix](on_paper(drawn, width)))


def plot_identification(identification: Identification | DroneFile) -> Picture:
    """Draws the estimates with their intervals, as shares of what is plausible."""
    known, unknown = identification.estimates, identification.unidentified
    return Picture(estimates(known, unknown, {}))


def plot_posterior(posterior: Posterior, optimum: Mapping[str, float] | None = None) -> Picture:
    """Draws each pair of parameters of joint samples."""
    return Picture(corner(posterior, optimum))


def plot_flight(flight: Flight) -> Picture:
    """Draws position, attitude, body rates and commands over time."""
    rows = slice(None, None, 1 + len(flight) // _MOST_ROWS)
    time = flight.period * np.arange(len(flight))[rows]
    signals = {
        "position x, y, z [m]": flight.position,
        "roll, pitch, yaw [deg]": np.degrees(flight.attitude),
        "body rates x, y, z [deg/s]": np.degrees(flight.body_rates),
        "commands of motors 1 to 4 [full thrust]": flight.command,
    }
    panels = [
        _lines(title, "time [s]", time, dict(zip("1234", values[rows].T, strict=False)))
        for title, values in signals.items()
        if np.isfinite(values).any()
    ]
    legend = _legend("x, roll, motor 1", "y, pitch, motor 2", "z, yaw, motor 3", "motor 4")
    return Picture(Figure(flight.name, panels, legend, least=360))


def plot_policy(policy: Policy) -> Picture:
    """Draws the commands of a drone at rest 1 m high over the set-point's distance on each axis."""
    actor, still = Actor(policy, 1.0 / float(crazyflie().thrust_to_weight)), (0.0, 0.0, 0.0)
    position = np.array([0.0, 0.0, 1.0])
    level = Measurement(*map(jnp.asarray, (position, still, (0.0, 0.0, 0.0, 1.0), still)))
    panels = []
    for number, axis in enumerate("xyz"):
        commands = []
        for offset in _OFFSETS:
            actor.reset()
            setpoint = position + offset * np.eye(3)[number]
            points = policy.spec.look_ahead.points
            ahead = np.tile(setpoint, (points, 1)) if points else None
            commands.append(actor.act(level, setpoint, ahead).command)
        lines = dict(zip("1234", np.array(commands).T, strict=True))
        panels.append(_lines(f"set-point along {axis}", "distance [m]", _OFFSETS, lines))
    names = [f"command {n} [{unit}]" for n, unit in enumerate(policy.interface.units, 1)]
    return Picture(Figure(f"{policy!r} at rest", panels, _legend(*names), columns=3))


def _legend(*names: str) -> list[Entry]:
    return [
        Entry(name, colour, "line", str(number))
        for number, (name, colour) in enumerate(zip(names, charts.PALETTE, strict=True), 1)
    ]


def _lines(title: str, x: str, places: np.ndarray, lines: Mapping[str, np.ndarray]) -> Spec:
    rows = [
        {"series": series, "x": at, "y": value}
        for series, values in lines.items()
        for at, value in zip(places, values, strict=True)
    ]
    domain = {"domain": list("1234"), "range": [charts.paint(colour) for colour in charts.PALETTE]}
    colour = {"field": "series", "type": "nominal", "scale": domain, "legend": None}
    channels = {"x": charts.number("x", x), "y": charts.number("y", scale={"zero": False})}
    layer = charts.layer("", {"type": "line", "strokeWidth": 1}, **channels, color=colour)
    return charts.panel(charts.rows(rows), [layer], title=title, height=150)
