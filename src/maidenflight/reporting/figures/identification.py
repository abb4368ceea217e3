"""Draws estimates and their intervals: the picture beside the drone file."""

from collections.abc import Mapping, Sequence

from maidenflight.identification.drone_file import Estimate, GroupGain
from maidenflight.identification.likelihood.selection import SMALLEST_GAIN
from maidenflight.identification.outcome.estimates import Identification
from maidenflight.identification.uncertainty import DELAY, Evidence
from maidenflight.parameters import Parameters, component
from maidenflight.reporting import text
from maidenflight.reporting.figures import charts, intervals
from maidenflight.reporting.figures.charts import Entry, Figure, Spec

_OUTSIDE = -0.25, 1.25
"""Shares of a plausible range beyond which an arrow at the edge stands for marks."""
_WEAK = 0.5
"""Share of a plausible range from which on an interval is no finding of the flights."""
_TOOLTIP = {"name": "", "value": "value", "between": "95 % interval", "source": ""}
_ENTRIES = {
    "identified": Entry("identified, 95 % interval", "orange", "bar", "identified"),
    "weak": Entry("identified, over half of what was plausible", "soft", "bar", "weak"),
    "unidentified": Entry("not identified: plausible range", "line", "thick", "unidentified"),
    "truth": Entry("truth", "green", "tick", "truth"),
    "start": Entry("start", "purple", "tick", "start"),
    "paper": Entry("paper", "purple", "tick", "paper"),
    "outside": Entry("lies or runs farther out", "soft", "arrow"),
}
"""The legend, by series."""
References = Mapping[str, Mapping[str, Sequence[float]]]
"""What is known of parameters besides, by series and parameter: one value or more [SI]."""


def identification(result: Identification, start: Parameters) -> Figure:
    """Draws intervals beside the start's values, estimates of the lag, and gains of groups.

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
    delays = [estimate for estimate in result.evidence if estimate.parameter == DELAY]
    panels += [_draw_delays(delays)] if delays else []
    panels += [_gains(result.gains)] if result.gains else []
    title = f"Identified from {source.seconds:.0f} s of {kind}"
    return Figure(title, panels, figure.legend, columns=1)


def plausible_range(estimate: Estimate) -> tuple[float, float]:
    """Returns what was plausible before the flights, or else what was searched."""
    return estimate.plausible or estimate.bounds or estimate.interval


def estimates(
    known: Mapping[str, Estimate],
    unknown: Mapping[str, tuple[float, float]],
    references: References,
) -> Figure:
    """Returns a row a parameter, all as shares of what is plausible before the flights.

    So the width of an interval shows what the flights add.

    Args:
        known: estimates by parameter.
        unknown: plausible ranges of what could not be identified.
        references: what else is marked, the first in numbers too.
    """
    names: list[tuple[str, ...]] = []
    marks, priors = [], {name: plausible_range(known[name]) for name in known} | dict(unknown)
    for row, name in enumerate((*known, *unknown)):
        low, high = known[name].interval if name in known else unknown[name]
        others = {series: values[name] for series, values in references.items() if name in values}
        scale, digits, unit = text.rounding(name, low, high)

        def share(value: float, ends: tuple[float, float] = priors[name]) -> float:
            return (value - ends[0]) / (ends[1] - ends[0])

        def written(value: float, scale: float = scale, digits: int = digits) -> str:
            return text.fixed(scale * value, digits)

        between = f"{written(low)} .. {written(high)} {unit}".rstrip()
        common = {"row": row, "name": text.label(name), "between": between}
        series, colour = ("identified", "orange") if name in known else ("unidentified", "line")
        if name in known and share(high) - share(low) > _WEAK:
            series, colour = "weak", "soft"
        common |= {"series": series, "colour": charts.paint(colour)}
        marks.append({**common, "kind": "bar", "x": share(low), "x2": share(high)})
        numbers = f"not identified, {written(low)} .. {written(high)} {unit}"
        if name in known:
            value = known[name].value
            marks.append({**common, "kind": "value", "x": share(value), "value": written(value)})
            numbers = f"{written(value)} [{written(low)}, {written(high)}] {unit}"
        for series, values in others.items():
            look = {"series": series, "colour": charts.paint(_ENTRIES[series].colour)}
            look |= {"row": row, "kind": "line", "name": common["name"], "source": series}
            marks += [{**look, "x": share(each), "value": written(each)} for each in values]
        first = next(iter(others), None)
        reference_text = f", {first} {' .. '.join(map(written, others[first]))}" if first else ""
        names.append((common["name"], numbers.rstrip(), reference_text))
    places = [mark[end] for mark in marks for end in ("x", "x2") if end in mark]
    ends = [
        max(_OUTSIDE[0], min([0.0, *places])) - 0.02,
        min(_OUTSIDE[1], max([1.0, *places])) + 0.02,
    ]
    x = intervals.plausible_axis() | {"scale": {"domain": ends, "nice": False}}
    arrows = [arrow for mark in marks for arrow in _arrows(mark, ends[0], ends[1])]
    series_names = {mark["series"] for mark in marks} | ({"outside"} if arrows else set())
    marks += arrows
    legend = [entry for series, entry in _ENTRIES.items() if series in series_names]
    return Figure("Estimates", [intervals.rows(names, marks, x, _TOOLTIP)], legend, columns=1)


def _arrows(mark: Spec, low: float, high: float) -> list[Spec]:
    """Arrows at the edges, which a mark lies beyond or runs over."""
    room = 0.008 * (high - low)
    edges = {"left": (low, low + room), "right": (high, high - room)}
    return [
        {**mark, "kind": side, "x": inside, "x2": None}
        for side, (edge, inside) in edges.items()
        if any((mark[end] - edge) * (edge - inside) > 0 for end in ("x", "x2") if end in mark)
    ]


def _draw_delays(evidence: Sequence[Evidence]) -> Spec:
    """Draws a row for each signal, on one axis in milliseconds; orange is the estimate."""
    names, marks = [], []
    for row, look in enumerate(evidence):
        value, low, high = (1e3 * each for each in (look.value, *look.interval))
        colour = charts.paint("orange" if look.is_taken else "blue")
        bar = {"row": row, "kind": "bar", "x": low, "x2": high, "colour": colour}
        marks += [bar, {"row": row, "kind": "value", "x": value, "colour": colour}]
        names.append((look.signal, f"{value:.1f} [{low:.1f}, {high:.1f}] ms"))
    room = {"scale": {"zero": False, "nice": False, "padding": 10}}
    x = charts.number("x", "[ms]", **room)
    return intervals.rows(names, marks, x, title="Motor lag, of both ways together, plus latency")


def _gains(gains: Sequence[GroupGain]) -> Spec:
    """Draws a row for each group: its gain, on an axis that is linear about zero."""
    names, marks = [], []
    for row, gain in enumerate(gains):
        value, error = gain.log_likelihood_gain, gain.standard_error
        colour = charts.paint("orange" if gain.is_in_model else "soft")
        low, high = (value + side * (error or 0.0) for side in (-2, 2))
        bar = {"row": row, "kind": "bar", "x": low, "x2": high, "colour": colour}
        marks += [bar, {"row": row, "kind": "value", "x": value, "colour": colour}]
        width = "" if error is None else f" ± {text.number(error, 1)}"
        numbers = f"{'+' if value > 0 else ''}{text.number(value, 2)}{width}"
        verdict = "in the model" if gain.is_in_model else "left out"
        names.append((text.label(gain.group), numbers, f", {verdict}"))
    powers = [10.0**power for power in range(-2, 4)]
    scale = {"type": "symlog", "constant": SMALLEST_GAIN, "nice": False, "padding": 10}
    axis = {"values": [*(-power for power in powers), 0.0, *powers], "format": "~r"}
    words = f"nats a row, with two standard errors; in the model from {SMALLEST_GAIN:g} on"
    x = charts.number("x", words, scale=scale, axis=axis)
    least = {"type": "rule", "strokeDash": [7, 4], "color": charts.paint("soft")}
    title = "Log-likelihood gain of each group"
    return intervals.rows(names, marks, x, title=title, across=[(SMALLEST_GAIN, least)])
