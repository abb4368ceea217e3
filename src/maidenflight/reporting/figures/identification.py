"""Draws estimates and their intervals: the picture beside the drone file."""

from collections.abc import Mapping, Sequence

from maidenflight.identification.drone_file import Estimate, GroupGain
from maidenflight.identification.likelihood.selection import SMALLEST_GAIN
from maidenflight.identification.outcome.estimates import Identification
from maidenflight.identification.signals.motor_response import DelayEstimate
from maidenflight.parameters import Parameters, component
from maidenflight.reporting import text
from maidenflight.reporting.figures import charts, intervals
from maidenflight.reporting.figures.charts import Entry, Figure, Spec

_TOOLTIP = {"name": "", "value": "value", "between": "95 % interval", "source": ""}
_ENTRIES = {
    "identified": Entry("identified, 95 % interval", "orange", "bar", "identified"),
    "unidentified": Entry("plausible, not identifiable", "line", "thick", "unidentified"),
    "truth": Entry("truth", "green", "tick", "truth"),
    "start": Entry("start", "purple", "tick", "start"),
    "paper": Entry("paper", "purple", "tick", "paper"),
}
"""The legend, by series."""
References = Mapping[str, Mapping[str, Sequence[float]]]
"""What is known of parameters besides, by series and parameter: one value or more [SI]."""


def identification(result: Identification, start: Parameters) -> Figure:
    """Intervals beside the start's values, looks at the motors' lag, and gains of groups.

    Args:
        result: the result.
        start: the drone that the search began with.
    """
    source = result.source
    kind = "flight" if not source.simulated else "flight, some or all simulated"
    names = [*result.estimates, *result.unidentified]
    references = {"start": {name: [float(component(start, name))] for name in names}}
    figure = estimates(result.estimates, result.unidentified, references)
    panels = [*figure.panels]
    panels += [_draw_delays(result.delay_estimates)] if result.delay_estimates else []
    panels += [_gains(result.gains)] if result.gains else []
    title = f"Identified from {source.seconds:.0f} s of {kind}"
    return Figure(title, panels, figure.legend, columns=1)


def estimates(
    known: Mapping[str, Estimate],
    unknown: Mapping[str, tuple[float, float]],
    references: References,
) -> Figure:
    """Returns a row a parameter, each on a scale of its own.

    Args:
        known: estimates by parameter.
        unknown: plausible ranges of what could not be identified.
        references: what else is marked, the first in numbers too.
    """
    names, marks = [], []
    for row, name in enumerate((*known, *unknown)):
        low, high = known[name].interval if name in known else unknown[name]
        others = {series: values[name] for series, values in references.items() if name in values}
        ends = charts.margin([low, high, *(value for each in others.values() for value in each)])
        scale, digits, unit = text.rounding(name, low, high)

        def place(value: float, ends: tuple[float, float] = ends) -> float:
            return (value - ends[0]) / (ends[1] - ends[0])

        def written(value: float, scale: float = scale, digits: int = digits) -> str:
            return text.fixed(scale * value, digits)

        between = f"{written(low)} .. {written(high)} {unit}".rstrip()
        common = {"row": row, "name": name.replace("_", " "), "between": between}
        series, colour = ("identified", "orange") if name in known else ("unidentified", "line")
        common |= {"series": series, "colour": charts.paint(colour)}
        marks.append({**common, "kind": "bar", "x": place(low), "x2": place(high)})
        numbers = f"{written(low)} .. {written(high)}"
        if name in known:
            value = known[name].value
            marks.append({**common, "kind": "value", "x": place(value), "value": written(value)})
            numbers = f"{written(value)} [{written(low)}, {written(high)}]"
        for series, values in others.items():
            look = {"series": series, "colour": charts.paint(_ENTRIES[series].colour)}
            look |= {"row": row, "kind": "line", "name": common["name"], "source": series}
            marks += [{**look, "x": place(each), "value": written(each)} for each in values]
        first = next(iter(others), None)
        reference_text = f", {first} {' .. '.join(map(written, others[first]))}" if first else ""
        names.append((common["name"], f"{numbers}{reference_text} {unit}".rstrip()))
    x = charts.number("x", **charts.within(0.0, 1.0), axis=None)
    series_names = {mark["series"] for mark in marks}
    legend = [entry for series, entry in _ENTRIES.items() if series in series_names]
    return Figure("Estimates", [intervals.rows(names, marks, x, _TOOLTIP)], legend, columns=1)


def _draw_delays(delay_estimates: Sequence[DelayEstimate]) -> Spec:
    """A row a signal, on one axis in milliseconds; the last is what was taken."""
    names, marks = [], []
    for row, look in enumerate(delay_estimates):
        value, low, high = (1e3 * each for each in (look.value, *look.interval))
        colour = charts.paint("orange" if row == len(delay_estimates) - 1 else "blue")
        bar = {"row": row, "kind": "bar", "x": low, "x2": high, "colour": colour}
        marks += [bar, {"row": row, "kind": "value", "x": value, "colour": colour}]
        names.append((look.signal, f"{value:.1f} [{low:.1f}, {high:.1f}] ms"))
    room = {"scale": {"zero": False, "nice": False, "padding": 10}}
    x = charts.number("x", "motor lag and latency together [ms]", **room)
    return intervals.rows(names, marks, x, title="Looks at the lag")


def _gains(gains: Sequence[GroupGain]) -> Spec:
    """A row a group: its gain with two standard errors, on an axis that is linear about zero."""
    names, marks = [], []
    for row, gain in enumerate(gains):
        value, error = gain.log_likelihood_gain, gain.standard_error
        colour = charts.paint("orange" if gain.is_in_model else "soft")
        low, high = (value + side * (error or 0.0) for side in (-2, 2))
        bar = {"row": row, "kind": "bar", "x": low, "x2": high, "colour": colour}
        marks += [bar, {"row": row, "kind": "value", "x": value, "colour": colour}]
        width = "" if error is None else f" ± {text.number(error, 1)}"
        numbers = f"{'+' if value > 0 else ''}{text.number(value, 2)}{width}"
        verdict = "kept" if gain.is_in_model else "not kept"
        names.append((gain.group.replace("_", " "), f"{numbers}, {verdict}"))
    powers = [10.0**power for power in range(-2, 4)]
    scale = {"type": "symlog", "constant": SMALLEST_GAIN, "nice": False, "padding": 10}
    axis = {"values": [*(-power for power in powers), 0.0, *powers], "format": "~r"}
    words = f"nats a row, with two standard errors; kept from {SMALLEST_GAIN:g} on"
    x = charts.number("x", words, scale=scale, axis=axis)
    least = {"type": "rule", "strokeDash": [7, 4], "color": charts.paint("soft")}
    title = "Log-likelihood gain of each group"
    return intervals.rows(names, marks, x, title=title, across=[(SMALLEST_GAIN, least)])
