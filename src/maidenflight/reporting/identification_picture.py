"""The picture of an identification, beside the drone file: what was found and how sure it is."""

import math
from collections.abc import Sequence

from maidenflight.identification.drone_file import GroupGain
from maidenflight.identification.likelihood.selection import SMALLEST_GAIN
from maidenflight.identification.outcome.estimates import Identification
from maidenflight.identification.signals.motor_response import Look
from maidenflight.parameters import Parameters, component
from maidenflight.reporting import svg, text
from maidenflight.reporting.svg import Panel

WIDTH = 920.0
"""Of the picture [px]."""
ROW = 24.0
"""Height of a row [px]."""
_LEFT, _RIGHT = 180.0, 310.0
"""Room for names at the left, for numbers at the right [px]."""


def identification_picture(found: Identification, start: Parameters) -> str:
    """Intervals beside the start's values, looks at the motors' lag, and gains of groups; an SVG.

    Args:
        found: the result.
        start: the drone that the search began with.
    """
    source = found.source
    kind = "flight" if not source.simulated else "flight, some or all simulated"
    title = f"Identified from {source.seconds:.0f} s of {kind}"
    parts, down = [], svg.TITLE + 6.0
    blocks = (
        _intervals(found, start, down),
        *([_looks(found.lag_looks, down)] if found.lag_looks else []),
        *([_gains(found.gains, down)] if found.gains else []),
    )
    for drawn, tall in blocks:
        parts.append(f'<g transform="translate(0 {down - svg.TITLE - 6:.1f})">{drawn}</g>')
        down += tall
    return svg.picture(WIDTH, down, title, parts)


def _panel(top: float, rows: int, x: tuple[float, float]) -> Panel:
    return Panel(_LEFT, top, WIDTH - _LEFT - _RIGHT, ROW * rows + 8, x, (0.0, 1.0))


def _middle(panel: Panel, row: int) -> float:
    """Of a row, from the panel's upper edge [px]."""
    return 4 + (row + 0.5) * ROW


def _bar(panel: Panel, low: float, high: float, value: float, down: float, colour: str) -> str:
    """An interval and its value."""
    left, right, centre = (float(place) for place in panel.across([low, high, value]))
    return svg.stroke(f"M{left:.1f} {down:.1f}H{right:.1f}", "heavy", colour) + svg.stroke(
        f"M{centre:.1f} {down - 6:.1f}v12", "heavy", colour
    )


def _beside(panel: Panel, row: int, name: str, numbers: str) -> list[str]:
    """What stands left and right of a row."""
    down = panel.top + _middle(panel, row) + 4.5
    return [
        svg.text(panel.left - 10, down, name, "", "end"),
        svg.text(panel.left + panel.width + 10, down, numbers),
    ]


def _intervals(found: Identification, start: Parameters, top: float) -> tuple[str, float]:
    """A row a parameter, each on a scale of its own, from its interval to the start's value."""
    entries = [
        (svg.stroke("M2 6H22M12 0V12", "heavy", "orange"), "identified, 95 % interval"),
        (svg.stroke("M12 0V12", "line", "purple"), "start"),
    ]
    if found.unidentified:
        entries.append((svg.stroke("M2 6H22", "heavy", "line"), "plausible, not identifiable"))
    legend, tall = svg.legend(top, WIDTH, entries)
    names = [*found.estimates, *found.unidentified]
    panel = _panel(top + tall + 6, len(names), (0.0, 1.0))
    parts, content = [legend], []
    for row, name in enumerate(names):
        before, known = float(component(start, name)), found.estimates.get(name)
        low, high = found.unidentified[name] if known is None else known.interval
        ends = svg.margin([low, high, before])
        own, down = panel._replace(x=ends), _middle(panel, row)
        content.append(svg.stroke(f"M0 {down:.1f}H{panel.width:.1f}", "grid", "grid"))
        begun = float(own.across(before))
        content.append(svg.stroke(f"M{begun:.1f} {down - 8:.1f}v16", "line", "purple"))
        if known is None:
            left, right = (float(place) for place in own.across([low, high]))
            content.append(svg.stroke(f"M{left:.1f} {down:.1f}H{right:.1f}", "heavy", "line"))
        else:
            content.append(_bar(own, low, high, known.value, down, "orange"))
        value = before if known is None else known.value
        numbers = _numbers(name, [value, low, high, before])
        parts += _beside(panel, row, name.replace("_", " "), numbers)
    parts.append(svg.framed(panel, content, "intervals"))
    return "".join(parts), tall + panel.height + 30


def _numbers(name: str, values: Sequence[float]) -> str:
    """A value, its interval and that of the start, as they are shown."""
    scale, unit = text.scale(name, values[:3])
    digits = text.places(scale * (values[2] - values[1]))
    value, low, high, before = (f"{scale * each:.{digits}f}" for each in values)
    shown = f"{value} [{low}, {high}], start {before} {unit}"
    return shown.replace("-", "\N{MINUS SIGN}").rstrip()


def _upright(panel: Panel, value: float) -> str:
    place = float(panel.across(value))
    return svg.stroke(f"M{place:.1f} 0V{panel.height:.1f}", "grid", "grid")


def _looks(looks: Sequence[Look], top: float) -> tuple[str, float]:
    """A row a signal, on one axis in milliseconds; the last is what was taken."""
    ends = [1e3 * end for look in looks for end in (*look.interval, look.value)]
    panel = _panel(top + 30, len(looks), svg.margin(ends, floor=0.0))
    outside, _ = svg.axes(panel, "motor lag and latency together [ms]", "", left=False)
    parts = [svg.text(0, top + 16, "Looks at the lag", "title"), outside]
    content = [_upright(panel, place) for place in svg.ticks(*panel.x, 6)[0]]
    for row, look in enumerate(looks):
        low, high = (1e3 * end for end in look.interval)
        colour = "orange" if row == len(looks) - 1 else "blue"
        content.append(_bar(panel, low, high, 1e3 * look.value, _middle(panel, row), colour))
        numbers = f"{1e3 * look.value:.1f} [{low:.1f}, {high:.1f}] ms"
        parts += _beside(panel, row, look.signal, numbers)
    parts.append(svg.framed(panel, content, "looks"))
    return "".join(parts), panel.height + 92


def _gains(gains: Sequence[GroupGain], top: float) -> tuple[str, float]:
    """A row a group: its gain with two standard errors, on an axis that is linear about zero."""
    spread = [0.0 if gain.standard_error is None else gain.standard_error for gain in gains]
    middle = [gain.log_likelihood_gain for gain in gains]
    reach = [
        _bent(value + side * error)
        for value, error in zip(middle, spread, strict=True)
        for side in (-2, 2)
    ]
    panel = _panel(top + 30, len(gains), svg.margin([*reach, _bent(2 * SMALLEST_GAIN), 0.0]))
    parts = [svg.text(0, top + 16, "Log-likelihood gain of each group", "title")]
    content = []
    for value in _round(panel):
        content.append(_upright(panel, _bent(value)))
        name, across = f"{value:g}".replace("-", "\N{MINUS SIGN}"), panel.across(_bent(value))
        foot = panel.top + panel.height
        parts.append(svg.text(panel.left + float(across), foot + 17, name, "", "middle"))
    least = float(panel.across(_bent(SMALLEST_GAIN)))
    content.append(svg.stroke(f"M{least:.1f} 0V{panel.height:.1f}", "thin dashed", "soft"))
    words = f"nats a row, with two standard errors; kept from {SMALLEST_GAIN:g} on"
    middle_of = panel.left + panel.width / 2
    parts.append(svg.text(middle_of, panel.top + panel.height + 36, words, "", "middle"))
    for row, gain in enumerate(gains):
        value, error = gain.log_likelihood_gain, spread[row]
        ends = _bent(value - 2 * error), _bent(value + 2 * error)
        colour = "orange" if gain.kept else "soft"
        content.append(_bar(panel, *ends, _bent(value), _middle(panel, row), colour))
        width = "" if gain.standard_error is None else f" ± {error:.1g}"
        numbers = f"{value:+.2g}{width}, {'kept' if gain.kept else 'not kept'}"
        numbers = numbers.replace("-", "\N{MINUS SIGN}")
        parts += _beside(panel, row, gain.group.replace("_", " "), numbers)
    parts.append(svg.framed(panel, content, "gains"))
    return "".join(parts), panel.height + 92


def _bent(gain: float) -> float:
    """A logarithm that is linear about zero."""
    return math.copysign(math.log10(1.0 + abs(gain) / SMALLEST_GAIN), gain)


def _round(panel: Panel) -> list[float]:
    """Powers of ten within a panel of gains, with zero between them."""
    powers = [10.0**power for power in range(-2, 4)]
    return [
        value
        for value in (*(-power for power in powers), 0.0, *powers)
        if panel.x[0] < _bent(value) < panel.x[1]
    ]
