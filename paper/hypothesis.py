"""The paper's hypothesis as a statistic: whether low-level control needs higher fidelity.

`python paper/hypothesis.py zero_shot/flights.csv zero_shot_100hz/flights.csv --authors
../shared/data/authors -o hypothesis` reads tables of zero-shot flights, as `figure_4.py` writes
them, and the published real ones. It asks how flight time falls with the distance between the drone
that a policy was trained for and the one that it flies, and whether it falls more steeply for PWM
than for attitude-rate and attitude policies: with policies that fly at the rate of their training,
and with those trained at one rate and flown at another, as the authors' were. It prints tables and
verdicts, and writes `statistics.csv` and `hypothesis.svg`.

Distance is told by one number, the total lag from command to thrust as a policy sees it
(`total_lag`), because flights determine the sum of motor lag and latency well and its parts badly
(docs/identification.md). It is used twice: `lag` is that of training less that of the reality, with
its sign, and `distance` is its size. Both mislead somewhere. `distance` takes too much lag in
training for as bad as too little, and `lag` takes it for good: on the real drone policies trained
for 140 ms, 50 ms too much, are among the best. Neither tells latency from motor lag, which is why
slopes with each of the two stand beside them.

The unit is the policy, with its mean flight time. Intervals are 95 % by bootstrap over the policies
of each control structure (percentiles: unlike BCa they exist where a whole structure falls at once
or never falls; on 300 synthetic data sets of 9, 18 and 27 policies, cut at 20 s, they held the
slope in 93, 90 and 91 %). Policies are not redrawn cell by cell: with three in a cell variances
would come out a third too small, and it would not count that the means of cells need not lie on a
line. For that the cells themselves are redrawn beside it.

Flights are cut at 20 s, and none is shorter than a fall takes. So mean flight times saturate at
both ends: where most policies of a structure reach 20 s, or fall at once, its slope comes out too
flat. The share of flights that reach 20 s does not depend on how long those would have lasted, and
rank correlations depend on order alone; both stand beside the slopes.

Source: Gronauer et al. 2022, sec. Methods, sec. Zero-Shot Experiments and sec. Discussion
(Control-level Hypothesis).
"""

import argparse
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import polars
from figure_4 import read_published_flights
from jaxtyping import Float
from scipy import stats

from maidenflight import parameters, results, terminal
from maidenflight.errors import InputError
from maidenflight.experiments.drones import find_reality
from maidenflight.experiments.transfer import MAX_DURATION_S
from maidenflight.parameters import Parameters, replace
from maidenflight.reporting.figures import charts, picture
from maidenflight.reporting.figures.charts import Entry, Figure, Spec
from maidenflight.reporting.figures.flight_times import COLOURS
from maidenflight.simulator.controllers.interface import CONTROLS, INTERFACES
from maidenflight.simulator.realities.virtual_drone import VirtualDrone

IDENTIFIED = {"motor_time_constant": 0.0490, "spin_down_ratio": 2.278, "latency": 0.00687}
"""Of the authors' drone, from its PWM flights, identified with lags alone: a lag that grows with
the step down has no one mean."""
AUTHORS_RATE, AUTHORS_STEP = 100, 0.005
"""Actions a second [Hz] in training of all published policies, and the step [s] whose multiples,
rounded down, were their latencies (configurations and agents.py of phoenix-drone-simulation
c5d6907: 15 ms were trained as 10)."""
FEWEST = 6
"""Policies of a control structure, and three different lags among them, below which no slope is
told."""
MATCHING = "matching rates"
REAL = "real"

Column = Float[np.ndarray, "*resamples policies"]
Statistic = Callable[[Column, Column], Any]


def total_lag(drone: Parameters) -> float:
    """Mean response delay [s]: T_m (1 + T_down/T_up) / 2 + Delta + (Delta_e + tau_g) / 2.

    A torque speeds two rotors up and slows two down; the mean delay of the sum of their responses
    is the mean of the two lags. (For fast commands it is the harmonic mean, which is shorter: 68
    instead of 80 ms for the authors' drone.) Attitude is delayed by `estimator_delay` and body
    rates by `gyro_time_constant`; a policy sees both at once, so their mean is added. Half a
    control period of zero-order hold is left out: it is the same in training, unless rates differ,
    which is treated separately.
    """
    motors = float(drone.motor_time_constant) * (1.0 + float(drone.spin_down_ratio)) / 2.0
    return (
        motors
        + float(drone.latency)
        + (float(drone.estimator_delay) + float(drone.gyro_time_constant)) / 2.0
    )


class Data(NamedTuple):
    """Policies that flew one drone, all under one rule of rates."""

    reality: str
    rates: str
    """`MATCHING`, or the rate of training."""
    total_lag: float
    """Of the reality [s]."""
    policies: polars.DataFrame
    """A row a policy: control, motor_time_constant, latency, trained (total lag in training) [s],
    duration (mean) [s], share (of flights that reach 20 s), flights (number of)."""

    @property
    def name(self) -> str:
        """Such as "virtual-7, matching rates"."""
        return f"{self.reality}, {self.rates}"


_TRAINED = ["control", "training_rate", "motor_time_constant", "latency", "number"]
_POLICY = ["seed", *_TRAINED, "reality"]


def simulated(path: Path, nominal: str) -> polars.DataFrame:
    """Flights of a table: what `figure_4.gather_flights` gives, and the seed of its record.

    A table without training_rate is one of policies that were trained at the rate at which their
    structure flies.

    Args:
        path: the table.
        nominal: the drone whose other parameters were kept in training: a name or a TOML file.

    Raises:
        InputError: not such a table, flights cut before 20 s, or policies trained for another
            drone.
    """
    try:
        comments = [
            line
            for line in path.read_text(encoding="utf-8").splitlines()
            if line.startswith("# record: ")
        ]
        flights = polars.read_csv(path, comment_prefix="#")
        record = json.loads(comments[0].removeprefix("# record: ")) if comments else {}
        if "training_rate" not in flights.columns:
            own = {kind: _own_rate(kind) for kind in CONTROLS}
            flights = flights.with_columns(
                polars.col("control").replace_strict(own, default=None).alias("training_rate")
            )
        numbers = {
            "motor_time_constant": polars.Float64,
            "latency": polars.Float64,
            "duration": polars.Float64,
        }
        whole = {"training_rate": polars.Int64, "number": polars.Int64, "trial": polars.Int64}
        names = {"control": polars.String, "reality": polars.String}
        flights = flights.select(
            *(polars.col(name).cast(kind) for name, kind in {**names, **whole, **numbers}.items())
        )
    except (OSError, ValueError, polars.exceptions.PolarsError) as error:
        raise InputError(
            f"{path}: not a table of zero-shot flights ({str(error).splitlines()[0]}). Give one "
            "of figure_4.py."
        ) from error
    bad = (
        ~polars.col("control").is_in(CONTROLS)
        | polars.any_horizontal(polars.all().is_null())
        | ~polars.col("duration").is_between(0, math.inf)
    )
    if flights.is_empty() or flights.filter(bad).height:
        raise InputError(
            f"{path}: {flights.filter(bad).height or 'no'} flights with gaps. Expected a row a "
            f"flight of {', '.join(CONTROLS)}."
        )
    settings = record.get("settings", {})
    if settings.get("duration", MAX_DURATION_S) < MAX_DURATION_S:
        raise InputError(
            f"{path}: flights were cut after {settings['duration']:g} s. Only those of "
            f"{MAX_DURATION_S:g} s can be compared."
        )
    if settings.get("drone", Path(nominal).name) != Path(nominal).name:
        raise InputError(
            f"{path}: policies were trained around {settings['drone']}, not {Path(nominal).name}. "
            "Give it as --nominal."
        )
    return flights.with_columns(polars.lit(record.get("seed", 0)).alias("seed"))


def _own_rate(kind: str) -> int:
    return INTERFACES[kind]().rate


def real(folder: Path) -> polars.DataFrame:
    """The paper's real flights in the same columns, with the latencies that training really had.

    Raises:
        InputError: the folder lacks `flights.csv`, or that lacks a column.
    """
    try:
        flights = read_published_flights(folder)
        trained = np.floor_divide(flights["latency"].to_numpy(), AUTHORS_STEP) * AUTHORS_STEP
        told = [
            polars.lit(0).alias("seed"),
            polars.lit(AUTHORS_RATE).alias("training_rate"),
            polars.Series("latency", trained),
            polars.col("policy").alias("number"),
            polars.lit(REAL).alias("reality"),
        ]
        return flights.with_columns(told).select(*_POLICY, "duration")
    except polars.exceptions.PolarsError as error:
        raise InputError(
            f"{folder / 'flights.csv'}: not the authors' flights ({str(error).splitlines()[0]})."
        ) from error


def by_policy(flights: polars.DataFrame, nominal: Parameters) -> polars.DataFrame:
    """Flights' means, a row a policy and reality.

    `trained` is the total lag of the drone that it was trained for [s].
    """
    flown = flights.with_columns(polars.col("duration").clip(upper_bound=MAX_DURATION_S))
    means = [
        polars.col("duration").mean(),
        (polars.col("duration") >= MAX_DURATION_S).mean().alias("share"),
        polars.len().alias("flights"),
    ]
    rows = flown.group_by(_POLICY, maintain_order=True).agg(*means)
    drones = (
        replace(nominal, **constants)
        for constants in rows.select("motor_time_constant", "latency").iter_rows(named=True)
    )
    return rows.with_columns(
        polars.Series("trained", [total_lag(drone) for drone in drones], polars.Float64)
    )


def together(tables: Sequence[polars.DataFrame]) -> polars.DataFrame:
    """Flights of all tables; one that stands in several counts once.

    Raises:
        InputError: tables of one seed tell a flight differently.
    """
    flights = polars.concat(
        [table.select(*_POLICY, "trial", "duration") for table in tables]
    ).unique(maintain_order=True)
    twice = flights.filter(flights.select(*_POLICY, "trial").is_duplicated())
    if twice.height:
        which = ", ".join(
            f"{name} {value}"
            for name, value in twice.row(0, named=True).items()
            if name != "duration"
        )
        raise InputError(
            f"a flight is told twice, with different ends ({which}). Give tables whose policies "
            "have seeds of their own."
        )
    return flights


def data_sets(policies: polars.DataFrame, lags: Mapping[str, float]) -> list[Data]:
    """Groups policies by place and training rate.

    Matching rates together, and each rate of training that is not its structure's own.

    A structure whose own rate that is, as PWM's is 100 Hz, is in both.
    """
    own = polars.col("control").replace_strict(
        {kind: _own_rate(kind) for kind in CONTROLS}, return_dtype=polars.Int64
    )
    matches = polars.col("training_rate") == own
    found = []
    for (name,), here in policies.group_by("reality", maintain_order=True):
        matched, place = here.filter(matches), str(name)
        if matched.height and place != REAL:
            found.append(Data(place, MATCHING, lags[place], matched))
        for rate in (
            [AUTHORS_RATE]
            if place == REAL
            else here.filter(~matches)["training_rate"].unique().sort()
        ):
            found.append(
                Data(
                    place,
                    f"trained at {rate} Hz",
                    lags[place],
                    here.filter(polars.col("training_rate") == rate),
                )
            )
    return found


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


def estimate(
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

    def told(*places: np.ndarray, axis: int = -1) -> Any:
        values = [
            statistic(x[drawn], y[drawn]) for (x, y), drawn in zip(samples, places, strict=True)
        ]
        return values[0] if len(values) == 1 else values[0] - values[1]

    places = tuple(np.arange(len(y)) for _, y in samples)
    generator = np.random.default_rng(seed)
    drawn = stats.bootstrap(
        places, told, n_resamples=resamples, vectorized=True, method="percentile", rng=generator
    )
    low, high = drawn.confidence_interval
    return Estimate(float(told(*places)), float(low), float(high))


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
_TITLES = {
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


def sample(data: Data, kind: str, measure: Measure) -> Sample:
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


def enough(data: Data, kind: str) -> bool:
    """Whether a control structure has the policies that a slope needs."""
    own = data.policies.filter(polars.col("control") == kind)
    return own.height >= FEWEST and len(np.unique(own["trained"].to_numpy().round(6))) >= 3


class Told(NamedTuple):
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


def statistics(found: Sequence[Data], resamples: int, seed: int) -> list[Told]:
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
        samples = [sample(data, kind, measure), None if other is None else sample(*other, measure)]
        told = estimate(STATISTICS[measure.statistic], samples[0], samples[1], resamples, seed)
        sizes = [
            one.policies.filter(polars.col("control") == name)
            for one, name in ((data, kind), *([] if other is None else [other]))
        ]
        lines.append(
            Told(
                data.name,
                kind,
                less,
                measure,
                told,
                sum(map(len, sizes)),
                sum(int(size["flights"].sum()) for size in sizes),
            )
        )

    for data in found:
        kinds = [kind for kind in CONTROLS if enough(data, kind)]
        for measure in _TITLES:
            for kind in kinds:
                add(measure, data, kind)
            for kind, other in PAIRS:
                if kind in kinds and other in kinds:
                    add(measure, data, kind, other, (data, other))
    for data, other in rate_pairs(found):
        for kind in CONTROLS:
            if enough(data, kind) and enough(other, kind) and not same(data, other, kind):
                for measure in _TITLES:
                    add(measure, data, kind, other.name, (other, kind))
    return lines


def rate_pairs(found: Sequence[Data]) -> list[tuple[Data, Data]]:
    """For each reality its data of matching rates beside each of other rates."""
    pairs = ((one, other) for one in found for other in found)
    return [
        (one, other)
        for one, other in pairs
        if one.reality == other.reality and one.rates == MATCHING != other.rates
    ]


def same(data: Data, other: Data, kind: str) -> bool:
    """Whether a control structure's policies are the same in both."""
    one, two = (
        part.policies.filter(polars.col("control") == kind).select("seed", *_TRAINED)
        for part in (data, other)
    )
    return one.equals(two)


def look_up(
    lines: Sequence[Told], data: str, kind: str, less: str, measure: Measure
) -> Told | None:
    """A line of the statistics, if it is there."""
    wanted = (data, kind, less, measure)
    return next(
        (line for line in lines if (line.data, line.control, line.less, line.measure) == wanted),
        None,
    )


HOLDS, FAILS, UNKNOWN = "holds", "does not hold", "cannot tell"


def verdict(lines: Sequence[Told], data: str, measure: Measure) -> str:
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


def _sign(line: Told | None) -> int:
    return 0 if line is None else line.estimate.sign


def worst(lines: Sequence[Told], data: str) -> int | None:
    """Whether attitude policies fly shorter: 1 surely, -1 surely longer than one of the others.

    0 if neither is sure; `None` if a control structure is missing.
    """
    told = [
        look_up(lines, data, kind, "attitude", Measure("mean", TIME))
        for kind in CONTROLS
        if kind != "attitude"
    ]
    signs = [line.estimate.sign for line in told if line is not None]
    if len(signs) < len(told):
        return None
    return 1 if min(signs) > 0 else -1 if min(signs) < 0 else 0


_WORST = {
    1: "surely the worst",
    0: "not surely the worst",
    -1: "surely not the worst",
    None: "not to be compared, for want of policies",
}


def ranking(lines: Sequence[Told], matching: Data, other: Data) -> str:
    """The part of the paper's ranking, attitude worst, due to the rate of training."""
    before, after = worst(lines, other.name), worst(lines, matching.name)
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
    gain = f"matching rates change its mean flight time by {shown(change.estimate)} s"
    found = f"attitude, {other.rates}, is {_WORST[before]}, and with {MATCHING} {_WORST[after]}"
    return f"{matching.reality}: {found}; {gain}. {words.capitalize()}."


def shown(told: Estimate, decimals: int = 2) -> str:
    """Such as 1.20 [0.90, 1.51]."""
    value, low, high = (f"{round(number, decimals) + 0.0:.{decimals}f}" for number in told)
    return f"{value} [{low}, {high}]"


def as_table(lines: Sequence[Told]) -> polars.DataFrame:
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


COLUMNS = 3
NOTE = (
    "A dot is a policy, a ring one that was trained without latency; lines are those of least "
    "squares."
)


def chart(found: Sequence[Data]) -> Figure:
    """Flight times over the difference of lag between training and reality.

    A panel per data set, a colour per structure, a dot per policy.
    """
    legend = [Entry(kind.replace("_", " "), colour, "line") for kind, colour in COLOURS.items()]
    excess = [1e3 * (data.policies["trained"].to_numpy() - data.total_lag) for data in found]
    across = charts.margin([0.0, *np.concatenate(excess)])
    return Figure(
        "Flight time by the lag that policies were trained for",
        [_panel(data, across) for data in found],
        legend,
        columns=min(COLUMNS, len(found)),
    )


def _panel(data: Data, across: tuple[float, float]) -> Spec:
    rows: list[Spec] = []
    for shift, (kind, colour) in zip((-1.2, 0.0, 1.2), COLOURS.items(), strict=True):
        x, y = sample(data, kind, Measure("slope", TIME, "lag"))
        if len(x) == 0:
            continue
        common = {"series": kind, "colour": charts.paint(colour)}
        rows += [
            {
                **common,
                "kind": "line",
                "x": 10.0 * end,
                "y": y.mean() + slope(x, y) * (end - x.mean()),
            }
            for end in (x.min(), x.max())
        ]
        none = data.policies.filter(control=kind)["latency"].to_numpy() == 0.0
        rows += [
            {**common, "kind": "policy", "x": 10.0 * lag + shift, "y": time}
            | {"fill": charts.paint("paper") if hollow else common["colour"]}
            for lag, time, hollow in zip(x, y, none, strict=True)
        ]
    x = charts.number("x", "excess of lag in training [ms]", **charts.within(*across))
    ends = charts.within(-0.03 * MAX_DURATION_S, 1.03 * MAX_DURATION_S)
    colour, fill = (
        {"field": name, "type": "nominal", "scale": None} for name in ("colour", "fill")
    )
    place = {"x": x, "y": charts.number("y", "flight time [s]", **ends), "stroke": colour}
    zero = {"type": "rule", "strokeDash": [7, 4]}
    line = {"type": "line", "clip": True, "strokeWidth": 2}
    dot = {"type": "point", "size": 30, "opacity": 1, "strokeWidth": 1.4}
    layers: list[Spec] = [
        {"data": {"values": [{"x": 0}]}, "mark": zero, "encoding": {"x": x}},
        charts.layer("line", line, **place),
        charts.layer("policy", dot, **place, fill=fill),
    ]
    title = [data.name, f"its total lag: {1e3 * data.total_lag:.0f} ms"]
    return charts.panel(charts.rows(rows), layers, title=title, height=210, zooms=())


def tell(found: Sequence[Data], lines: Sequence[Told]) -> None:
    """Prints tables and verdicts."""
    for data in found:
        rows = []
        for measure, title in _TITLES.items():
            told = (
                look_up(lines, data.name, kind, less, measure)
                for kind, less in (*((kind, "") for kind in CONTROLS), *PAIRS)
            )
            rows.append([title, *("" if line is None else shown(line.estimate) for line in told)])
        counts = [data.policies.filter(polars.col("control") == kind) for kind in CONTROLS]
        rows.append(
            [
                "policies, flights",
                *(f"{part.height}, {part['flights'].sum()}" for part in counts),
                *("" for _ in PAIRS),
            ]
        )
        title = (
            f"{data.name}; total lag of the drone flown {1e3 * data.total_lag:.1f} ms; 95 % "
            "intervals"
        )
        terminal.print_table(
            title, ["", *CONTROLS, *(f"{kind} - {other}" for kind, other in PAIRS)], rows
        )
    print(
        "Low-level control needs higher fidelity: flight time falls more steeply for pwm than for "
        "attitude_rate and attitude."
    )
    for data in found:
        for against in DISTANCES:
            print(
                f"  {data.name}, by {against}: "
                f"{verdict(lines, data.name, Measure('slope', TIME, against))}"
            )
            checks = {
                SHARE: Measure("slope", SHARE, against),
                "cells redrawn": Measure("slope", TIME, against, "cell"),
            }
            print(
                "    "
                + "; ".join(
                    f"{name}: {verdict(lines, data.name, one).split(' (')[0]}"
                    for name, one in checks.items()
                )
            )
    print("Attitude control is the worst, in mean flight time.")
    for data in found:
        print(f"  {data.name}: attitude is {_WORST[worst(lines, data.name)]}.")
    if rate_pairs(found):
        print("What of it is due to training at another rate than that of flight.")
    for matching, other in rate_pairs(found):
        print(f"  {ranking(lines, matching, other)}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Reads, prints, writes and draws."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "tables",
        nargs="*",
        type=Path,
        help="flights.csv of figure_4.py",
    )
    parser.add_argument("--authors", type=Path, help="folder of the authors' data with flights.csv")
    parser.add_argument(
        "--drone",
        help="the real drone, identified, a TOML file (default: its values in "
        "docs/identification.md)",
    )
    parser.add_argument(
        "--nominal",
        default="crazyflie",
        help="drone of the training: a name or a TOML file (default: %(default)s)",
    )
    parser.add_argument(
        "--reality",
        action="append",
        default=[],
        metavar="NAME=WHAT",
        help="what a table's reality is: virtual:7, a TOML file",
    )
    parser.add_argument(
        "--lag",
        action="append",
        default=[],
        metavar="NAME=S",
        help="total lag of a reality (real: the authors'), seconds",
    )
    parser.add_argument(
        "--least-latency",
        type=float,
        default=0.0,
        metavar="S",
        help="leave out policies trained for less, seconds",
    )
    parser.add_argument(
        "--resamples", type=int, default=9999, help="of the bootstrap (default: %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        help="folder for statistics.csv and hypothesis.svg",
    )
    given = parser.parse_args(arguments)
    try:
        run(given)
    except InputError as error:
        parser.error(str(error))


def named(told: Sequence[str], option: str) -> dict[str, str]:
    """What options of the form NAME=VALUE say.

    Raises:
        InputError: one is of another form.
    """
    parts = [entry.partition("=") for entry in told]
    wrong = [
        entry for entry, (name, _, value) in zip(told, parts, strict=True) if not name or not value
    ]
    if wrong:
        raise InputError(
            f"{option} {wrong[0]}: expected NAME=VALUE, with the name that the table gives the "
            "reality."
        )
    return {name: value for name, _, value in parts}


def lags_of(realities: Sequence[str], given: argparse.Namespace) -> dict[str, float]:
    """Total lag [s] of each reality that is flown in: as given, or of its parameters.

    Raises:
        InputError: a lag is not a positive number, or nothing is known of a reality.
    """
    lags, places = named(given.lag, "--lag"), named(given.reality, "--reality")
    unused = [name for name in (*lags, *places) if name not in realities]
    if unused:
        raise InputError(f"no flight in {unused[0]}; there are flights in {', '.join(realities)}.")
    found = {}
    for name in realities:
        if name in lags:
            try:
                found[name] = float(lags[name])
            except ValueError:
                found[name] = math.nan
            if not 0.0 < found[name] < 1.0:
                raise InputError(
                    f"--lag {name}={lags[name]}: expected seconds, such as {name}=0.09."
                )
        elif name == REAL:
            found[name] = total_lag(
                parameters.read_drone(given.drone)
                if given.drone
                else replace(parameters.crazyflie(), **IDENTIFIED)
            )
        else:
            kind, _, seed = name.rpartition("-")
            try:
                # PyBullet is another engine for the same constants, and need not be installed to
                # ask for them.
                what = places.get(name, f"{'virtual' if kind == 'pybullet' else kind}:{seed}")
                place = find_reality(what)
                if not isinstance(place, VirtualDrone):
                    raise InputError(f"{what} has no parameters.")
                found[name] = total_lag(place.parameters)
            except InputError as error:
                raise InputError(
                    f"reality {name} is unknown ({error}) Give --reality {name}=FILE.toml or "
                    f"--lag {name}=SECONDS."
                ) from error
    return found


def run(given: argparse.Namespace) -> None:
    """All of it, for given arguments."""
    if not given.tables and given.authors is None:
        raise InputError("nothing to read. Give tables of flights, --authors, or both.")
    if given.resamples < 100:
        raise InputError(f"--resamples {given.resamples}: an interval of 95 % takes 100 or more.")
    nominal, parts = parameters.read_drone(given.nominal), []
    if given.tables:
        flown = together([simulated(path, given.nominal) for path in given.tables])
        if REAL in flown["reality"]:
            raise InputError(
                f"a table's reality is called {REAL}, as the authors' flights are. Give it "
                "another name."
            )
        parts.append(by_policy(flown, nominal))
    if given.authors is not None:
        parts.append(by_policy(real(given.authors), parameters.crazyflie()))
    policies = polars.concat(
        [part.select(sorted(part.columns)) for part in parts], how="vertical_relaxed"
    )
    lags = lags_of(policies["reality"].unique(maintain_order=True).to_list(), given)
    found = data_sets(policies.filter(polars.col("latency") > given.least_latency - 1e-6), lags)
    if not any(enough(data, kind) for data in found for kind in CONTROLS):
        raise InputError(
            f"no control structure has {FEWEST} policies of at least 3 lags. Give more flights."
        )
    lines = statistics(found, given.resamples, given.seed)
    inputs = [
        *given.tables,
        *([given.authors / "flights.csv"] if given.authors else []),
        *([given.drone] if given.drone else []),
    ]
    settings: dict[str, Any] = {
        "total_lag": {name: round(lag, 6) for name, lag in lags.items()},
        "resamples": given.resamples,
    }
    settings |= {"nominal": Path(given.nominal).name, "least_latency": given.least_latency}
    made = results.record(seed=given.seed, inputs=inputs, settings=settings)
    text = results.table_text(_STATISTICS, made, as_table(lines).write_csv())
    results.write(given.output / "statistics.csv", text)
    results.write(given.output / "hypothesis.svg", picture.svg(chart(found), note=NOTE))
    tell(found, lines)


_STATISTICS = (
    "# maidenflight hypothesis 1: slopes of flight time with the lag that policies were trained "
    "for; low and high are 95 % by bootstrap;"
    " less: a control structure or data set whose value is taken off"
)

if __name__ == "__main__":
    main()
