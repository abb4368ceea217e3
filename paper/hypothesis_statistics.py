"""Statistics of the hypothesis, with intervals by bootstrap, and the verdicts that they allow."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import polars
from hypothesis_data import MATCHING, TRAINED, Data
from jaxtyping import Float
from scipy import stats

from maidenflight.simulator.controllers.interface import CONTROLS

FEWEST = 6
"""Policies of a control structure, and three different lags among them, below which no slope is
told."""

Column = Float[np.ndarray, "*resamples policies"]
Statistic = Callable[[Column, Column], Any]


def slope(x: Column, y: Column) -> Any:
    """Slope of the straight line of least squares.

    0 where all x are the same, as a resample's may be.
    """
    centred = x - x.mean(axis=-1, keepdims=True)
    spread = (centred**2).sum(axis=-1)
    return np.where(spread > 1e-9, (centred * y).sum(axis=-1) / np.maximum(spread, 1e-9), 0.0)


def rank_correlation(x: Column, y: Column) -> Any:
    """Spearman's; 0 where all x or all y are the same."""
    ranks = [stats.rankdata(values, axis=-1) for values in (x, y)]
    ranks = [values - values.mean(axis=-1, keepdims=True) for values in ranks]
    spread = np.sqrt((ranks[0] ** 2).sum(axis=-1) * (ranks[1] ** 2).sum(axis=-1))
    return np.where(
        spread > 1e-9, (ranks[0] * ranks[1]).sum(axis=-1) / np.maximum(spread, 1e-9), 0.0
    )


def mean(_: Column, y: Column) -> Any:
    """Of y alone."""
    return y.mean(axis=-1)


class Estimate(NamedTuple):
    """A value and its 95 % interval."""

    value: float
    low: float
    high: float

    @property
    def sign(self) -> int:
        """1 or -1 if the whole interval is on that side of 0, else 0."""
        return int(self.low > 0) - int(self.high < 0)


Sample = tuple[np.ndarray, np.ndarray]


def estimate_difference(
    statistic: Statistic,
    sample: Sample,
    less: Sample | None = None,
    resamples: int = 9999,
    seed: int = 0,
) -> Estimate:
    """A statistic of a sample, or its difference from that of another, with a bootstrap interval.

    Each sample is redrawn by itself.
    """
    samples = [sample] if less is None else [sample, less]

    def difference(*places: np.ndarray, axis: int = -1) -> Any:
        values = [
            statistic(x[drawn], y[drawn]) for (x, y), drawn in zip(samples, places, strict=True)
        ]
        return values[0] if len(values) == 1 else values[0] - values[1]

    places = tuple(np.arange(len(y)) for _, y in samples)
    generator = np.random.default_rng(seed)
    drawn = stats.bootstrap(
        places,
        difference,
        n_resamples=resamples,
        vectorized=True,
        method="percentile",
        rng=generator,
    )
    low, high = drawn.confidence_interval
    return Estimate(float(difference(*places)), float(low), float(high))


class Measure(NamedTuple):
    """What is asked of a control structure's policies."""

    statistic: str
    """`slope`, `rank correlation` or `mean`."""
    of: str
    """`flight time` or `share of 20 s`."""
    against: str = ""
    """`distance`, `lag`, `motor_time_constant`, `latency`, or nothing for a mean."""
    unit: str = "policy"
    """What is redrawn: a policy, or a cell with all its policies."""


STATISTICS: dict[str, Statistic] = {
    "slope": slope,
    "rank correlation": rank_correlation,
    "mean": mean,
}
TIME, SHARE = "flight time", "share of 20 s"
DISTANCES = ("distance", "lag")
TITLES = {
    Measure("mean", TIME): "mean flight time, s",
    Measure("mean", SHARE): "share of flights of 20 s",
    Measure("slope", TIME, "distance"): "flight time with distance, s per 10 ms",
    Measure("slope", TIME, "distance", "cell"): "  the same, cells redrawn",
    Measure("slope", SHARE, "distance"): "  share of 20 s with distance, per 10 ms",
    Measure("rank correlation", TIME, "distance"): "  rank correlation with distance",
    Measure("slope", TIME, "lag"): "flight time with lag, s per 10 ms",
    Measure("slope", TIME, "lag", "cell"): "  the same, cells redrawn",
    Measure("slope", SHARE, "lag"): "  share of 20 s with lag, per 10 ms",
    Measure("rank correlation", TIME, "lag"): "  rank correlation with lag",
    Measure("slope", TIME, "motor_time_constant"): "  with motor lag alone, s per 10 ms",
    Measure("slope", TIME, "latency"): "  with latency alone, s per 10 ms",
}
PAIRS = [(kind, other) for place, kind in enumerate(CONTROLS) for other in CONTROLS[place + 1 :]]
"""Of control structures: the lower one first."""
UNITS = {("slope", TIME): "s/10 ms", ("slope", SHARE): "1/10 ms", ("mean", TIME): "s"}


def take_sample(data: Data, kind: str, measure: Measure) -> Sample:
    """Lags or distances in 10 ms, and what is measured, of a control structure's policies."""
    own = data.policies.filter(polars.col("control") == kind)
    if measure.unit == "cell":
        own = own.group_by("motor_time_constant", "latency", maintain_order=True).agg(
            polars.col("trained", "duration", "share").mean()
        )
    lag = 100.0 * (own["trained"].to_numpy() - data.total_lag)
    others = {name: 100.0 * own[name].to_numpy() for name in ("motor_time_constant", "latency")}
    x = {"distance": np.abs(lag), "lag": lag, "": lag, **others}[measure.against]
    return x, own["duration" if measure.of == TIME else "share"].to_numpy()


def has_enough(data: Data, kind: str) -> bool:
    """Whether a control structure has the policies that a slope needs."""
    own = data.policies.filter(polars.col("control") == kind)
    return own.height >= FEWEST and len(np.unique(own["trained"].to_numpy().round(6))) >= 3


class Line(NamedTuple):
    """A line of the statistics."""

    data: str
    control: str
    less: str
    """The control structure, or for the same one the data set, whose value is taken off; empty for
    none."""
    measure: Measure
    estimate: Estimate
    policies: int
    flights: int


def compute_statistics(groups: Sequence[Data], resamples: int, seed: int) -> list[Line]:
    """All measures of all control structures.

    Their differences between structures, and for each structure between rates.
    """
    lines = []

    def add(
        measure: Measure,
        data: Data,
        kind: str,
        less: str = "",
        other: tuple[Data, str] | None = None,
    ) -> None:
        samples = [
            take_sample(data, kind, measure),
            None if other is None else take_sample(*other, measure),
        ]
        estimate = estimate_difference(
            STATISTICS[measure.statistic], samples[0], samples[1], resamples, seed
        )
        sizes = [
            one.policies.filter(polars.col("control") == name)
            for one, name in ((data, kind), *([] if other is None else [other]))
        ]
        lines.append(
            Line(
                data.name,
                kind,
                less,
                measure,
                estimate,
                sum(map(len, sizes)),
                sum(int(size["flights"].sum()) for size in sizes),
            )
        )

    for data in groups:
        kinds = [kind for kind in CONTROLS if has_enough(data, kind)]
        for measure in TITLES:
            for kind in kinds:
                add(measure, data, kind)
            for kind, other in PAIRS:
                if kind in kinds and other in kinds:
                    add(measure, data, kind, other, (data, other))
    for data, other in rate_pairs(groups):
        for kind in CONTROLS:
            if (
                has_enough(data, kind)
                and has_enough(other, kind)
                and not has_same_policies(data, other, kind)
            ):
                for measure in TITLES:
                    add(measure, data, kind, other.name, (other, kind))
    return lines


def rate_pairs(groups: Sequence[Data]) -> list[tuple[Data, Data]]:
    """For each reality its data of matching rates beside each of other rates."""
    pairs = ((one, other) for one in groups for other in groups)
    return [
        (one, other)
        for one, other in pairs
        if one.reality == other.reality and one.rates == MATCHING != other.rates
    ]


def has_same_policies(data: Data, other: Data, kind: str) -> bool:
    """Whether a control structure's policies are the same in both."""
    one, two = (
        part.policies.filter(polars.col("control") == kind).select("seed", *TRAINED)
        for part in (data, other)
    )
    return one.equals(two)


def look_up(
    lines: Sequence[Line], data: str, kind: str, less: str, measure: Measure
) -> Line | None:
    """A line of the statistics, if it is there."""
    wanted = (data, kind, less, measure)
    return next(
        (line for line in lines if (line.data, line.control, line.less, line.measure) == wanted),
        None,
    )


HOLDS, FAILS, UNKNOWN = "holds", "does not hold", "cannot tell"


def judge_slopes(lines: Sequence[Line], data: str, measure: Measure) -> str:
    """Whether flight time falls more steeply for PWM than for the others, as a line of text.

    It holds if the intervals say that PWM's falls, and falls more steeply than attitude rate's and
    than attitude's. (All three must say so: no correction for asking twice is due.) It does not
    hold if they say that another structure's falls, and more steeply than PWM's. Else nobody can
    tell. To fall is to have less flight time at more `distance`, or at less `lag` in training.
    """
    falling = -1 if measure.against == "distance" else 1
    own = look_up(lines, data, "pwm", "", measure)
    others = {
        kind: look_up(lines, data, "pwm", kind, measure) for kind in CONTROLS if kind != "pwm"
    }
    there = {kind: line for kind, line in others.items() if line is not None}
    if own is None or not there:
        return f"{UNKNOWN} (too few policies of pwm, or of all others)"
    signs = {kind: falling * line.estimate.sign for kind, line in there.items()}
    words = UNKNOWN
    if (
        len(there) == len(others)
        and falling * own.estimate.sign > 0
        and all(sign > 0 for sign in signs.values())
    ):
        words = HOLDS
    elif any(
        sign < 0 and falling * _sign(look_up(lines, data, kind, "", measure)) > 0
        for kind, sign in signs.items()
    ):
        words = FAILS
    falls = {1: "falls", -1: "rises", 0: "neither falls nor rises surely"}[
        falling * own.estimate.sign
    ]
    than = {1: "more steeply than", -1: "less steeply than", 0: "not surely otherwise than"}
    return (
        f"{words} (pwm {falls}; "
        f"{', '.join(f'{than[sign]} {kind}' for kind, sign in signs.items())})"
    )


def _sign(line: Line | None) -> int:
    return 0 if line is None else line.estimate.sign


def judge_attitude(lines: Sequence[Line], data: str) -> int | None:
    """Whether attitude policies fly shorter: 1 surely, -1 surely longer than one of the others.

    0 if neither is sure; `None` if a control structure is missing.
    """
    lines_of_rates = [
        look_up(lines, data, kind, "attitude", Measure("mean", TIME))
        for kind in CONTROLS
        if kind != "attitude"
    ]
    signs = [line.estimate.sign for line in lines_of_rates if line is not None]
    if len(signs) < len(lines_of_rates):
        return None
    return 1 if min(signs) > 0 else -1 if min(signs) < 0 else 0


WORST = {
    1: "surely the worst",
    0: "not surely the worst",
    -1: "surely not the worst",
    None: "not to be compared, for want of policies",
}


def describe_ranking(lines: Sequence[Line], matching: Data, other: Data) -> str:
    """The part of the paper's ranking, attitude worst, due to the rate of training."""
    before, after = judge_attitude(lines, other.name), judge_attitude(lines, matching.name)
    change = look_up(lines, matching.name, "attitude", other.name, Measure("mean", TIME))
    if before is None or after is None or change is None:
        return f"{matching.reality}: {UNKNOWN}, for want of policies."
    if before < 1:
        words = f"{UNKNOWN}: the ranking does not show here in the first place"
    elif after == 1:
        words = "the rates are not all of it: attitude is the worst with matching rates too"
    else:
        words = (
            "an artefact of the rates"
            if after == -1
            else "with matching rates it is no longer sure"
        )
    gain = f"matching rates change its mean flight time by {format_estimate(change.estimate)} s"
    ranking = f"attitude, {other.rates}, is {WORST[before]}, and with {MATCHING} {WORST[after]}"
    return f"{matching.reality}: {ranking}; {gain}. {words.capitalize()}."


def format_estimate(estimate: Estimate, decimals: int = 2) -> str:
    """Such as 1.20 [0.90, 1.51]."""
    value, low, high = (f"{round(number, decimals) + 0.0:.{decimals}f}" for number in estimate)
    return f"{value} [{low}, {high}]"


def tabulate(lines: Sequence[Line]) -> polars.DataFrame:
    """A row a line."""
    rows = [
        {
            "data": line.data,
            "control": line.control,
            "less": line.less,
            **line.measure._asdict(),
            **{name: round(value, 6) for name, value in line.estimate._asdict().items()},
            "in": UNITS.get((line.measure.statistic, line.measure.of), "-"),
            "policies": line.policies,
            "flights": line.flights,
        }
        for line in lines
    ]
    return polars.DataFrame(rows)
