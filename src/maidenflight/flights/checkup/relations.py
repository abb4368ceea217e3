"""Two signals that should be one: how well they match, at which scale and in which axes.

Both signals are means over a span of time, and of several spans the one is taken in which they
match best: short ones are full of noise, in long ones little is left of quick motion. A scale is
bounded by the two regressions, of either signal on the other, so that noise in neither shrinks it.

Source: Fuller 1987, Measurement error models, sec. 1.1.3.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.ndimage import uniform_filter1d

from maidenflight.flights.log import Flight, thinned

SPANS_S = (0.1, 0.3, 1.0)
"""Times over which signals are averaged [s]."""
RATE_HZ = 100.0
"""Rows a second that are enough to look at [Hz]."""
ENOUGH_S = 300.0
"""Flight that is enough to look at [s]."""
FEWEST = 100
"""Samples below which nothing is concluded."""
LASTING = 8.0
"""Spans that a flight must last for one to be looked at: fewer match by chance."""
_MOST = 1500
"""Samples that are looked at, evenly chosen of more."""
_TRIMMED = 0.95
"""Share of samples that counts: those nearest to one line."""

Samples = tuple[Float[np.ndarray, "M K"], Float[np.ndarray, "M K"]]
"""Two signals over one span, M samples of K axes."""
Measure = Callable[[Flight, int], Samples]
"""Gives two signals of a piece over a span of so many rows."""


class Match(NamedTuple):
    """How two signals of K axes match, each axis over the span in which it does best."""

    correlation: Float[np.ndarray, "K"]
    ratio: Float[np.ndarray, "K"]
    """Standard deviation of the first signal by that of the second."""
    size: Float[np.ndarray, "K"]
    """The lesser of both standard deviations."""

    def bounds(self) -> Float[np.ndarray, "K 2"]:
        """Returns the least and the largest scale that noise in either signal allows."""
        own = np.maximum(self.correlation, 1e-3)
        return np.stack([self.ratio * own, self.ratio / own], axis=1)


def take_enough(pieces: Sequence[Flight]) -> list[Flight]:
    """Returns the longest pieces, `ENOUGH_S` of them at most, at about `RATE_HZ` rows a second."""
    chosen_pieces, left = [], ENOUGH_S
    for piece in sorted(pieces, key=len, reverse=True):
        rows = min(len(piece), round(left / piece.period))
        if rows > 2:
            chosen_pieces.append(slow_down(piece.part(0, rows)))
            left -= rows * piece.period
    return chosen_pieces


def slow_down(piece: Flight) -> Flight:
    """Returns about `RATE_HZ` rows a second of a faster log, its body rates averaged."""
    every = int(1 / (RATE_HZ * piece.period) + 0.01)
    if every < 2:
        return piece
    rates = uniform_filter1d(piece.body_rates.astype(float), every, axis=0)
    return thinned(replace(piece, body_rates=rates.astype(np.float32)), every)


def block_mean(values: Float[np.ndarray, "N K"], rows: int) -> Float[np.ndarray, "M K"]:
    """Averages each `rows` rows."""
    count = len(values) // rows
    return values[: count * rows].reshape(count, rows, values.shape[1]).mean(1, dtype=np.float64)


def span_mean(values: Float[np.ndarray, "N K"], rows: int) -> Float[np.ndarray, "M K"]:
    """Averages over `rows` steps by the trapezium rule; M = N - rows."""
    summed = np.cumsum((values[1:] + values[:-1]).astype(np.float64) / 2, axis=0)
    return np.concatenate([summed[rows - 1 : rows], summed[rows:] - summed[:-rows]]) / rows


def sample_spans(pieces: Sequence[Flight], measure: Measure) -> list[Samples]:
    """Measures two signals over each span that pieces are long enough for."""
    spans = []
    for span in SPANS_S:
        parts = []
        for piece in pieces:
            rows = max(1, round(span / piece.period))
            if len(piece) > rows + 2:
                parts.append(measure(piece, rows))
        count = sum(len(first) for first, _ in parts)
        if count < FEWEST or count * pieces[0].period < LASTING * span:
            continue
        step = -(-count // _MOST)
        first, second = (np.concatenate(side)[::step] for side in zip(*parts, strict=True))
        if len(first):
            spans.append((first - np.median(first, axis=0), second - np.median(second, axis=0)))
    return spans


def match(samples: Sequence[Samples]) -> Match:
    """Matches each axis of two signals with itself."""
    spans = [
        [_match_axis(signal, other) for signal, other in zip(first.T, second.T, strict=True)]
        for first, second in samples
    ]
    table = np.array(spans)
    best = np.argmax(np.abs(table[:, :, 0]), axis=0)
    return Match(*table[best, np.arange(table.shape[1])].T)


def _match_axis(
    first: Float[np.ndarray, "M"], second: Float[np.ndarray, "M"]
) -> tuple[float, float, float]:
    size, other = float(first.std()), float(second.std())
    if min(size, other) < 1e-9:
        return 0.0, 1.0, min(size, other)
    sign = np.sign(first @ second) or 1.0
    difference = np.abs(first / size - sign * second / other)
    most = int(_TRIMMED * (len(difference) - 1))
    inliers = difference <= np.partition(difference, most)[most]
    first, second = first[inliers] - first[inliers].mean(), second[inliers] - second[inliers].mean()
    size, other = (float(np.sqrt(signal @ signal / len(signal))) for signal in (first, second))
    if min(size, other) < 1e-9:
        return 0.0, 1.0, min(size, other)
    return float(first @ second / len(first) / size / other), size / other, min(size, other)


class Reading(NamedTuple):
    """A way of reading a signal, and how well it matches then."""

    name: str
    score: float
    """Mean correlation over the axes that move enough."""
    logged: float
    """That of the signal as it was logged."""


def best_reading(readings: Mapping[str, Sequence[Samples]], least: float) -> Reading | None:
    """Finds the reading of a signal that matches another one best.

    Args:
        readings: samples over several spans by name, first the signal as logged.
        least: standard deviation of the second signal below which an axis is too quiet.

    Returns:
        None where too little moves.
    """
    scores: dict[str, float] = {}
    for name, samples in readings.items():
        sample_scores = [score for pair in samples if (score := _score(*pair, least)) is not None]
        if sample_scores:
            scores[name] = max(sample_scores)
    logged = next(iter(readings))
    if logged not in scores:
        return None
    best = max(scores, key=lambda name: scores[name])
    return Reading(best, scores[best], scores[logged])


def _score(
    first: Float[np.ndarray, "M K"], second: Float[np.ndarray, "M K"], least: float
) -> float | None:
    deviations = second.std(axis=0)
    loud = deviations > max(least, 0.02 * deviations.max())
    if not loud.any():
        return None
    rows = [
        _match_axis(signal, other)[0]
        for signal, other in zip(first.T[loud], second.T[loud], strict=True)
    ]
    return float(np.mean(rows))
