"""Zero-shot flights for the study of the hypothesis: policies, and the lag that they met."""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars
from figure_4 import read_published_flights

from maidenflight.errors import InputError
from maidenflight.experiments.transfer import MAX_DURATION_S
from maidenflight.parameters import Parameters, replace
from maidenflight.simulator.controllers.interface import CONTROLS, INTERFACES

IDENTIFIED = {"motor_time_constant": 0.0490, "spin_down_ratio": 2.278, "latency": 0.00687}
"""Of the authors' drone, from its PWM flights, identified with lags alone: a lag that grows with
the step down has no one mean."""
AUTHORS_RATE, AUTHORS_STEP = 100, 0.005
"""Actions a second [Hz] in training of all published policies, and the step [s] whose multiples,
rounded down, were their latencies (configurations and agents.py of phoenix-drone-simulation
c5d6907: 15 ms were trained as 10)."""
MATCHING = "matching rates"
REAL = "real"


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
        """Such as "virtual:7, matching rates"."""
        return f"{self.reality}, {self.rates}"


TRAINED = ["control", "training_rate", "motor_time_constant", "latency", "number"]
POLICY = ["seed", *TRAINED, "reality"]


def read_simulated_flights(path: Path, nominal: str) -> polars.DataFrame:
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
            own = {kind: own_rate(kind) for kind in CONTROLS}
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


def own_rate(kind: str) -> int:
    """Returns the rate [Hz] at which policies of a control structure act."""
    return INTERFACES[kind]().rate


def read_real_flights(folder: Path) -> polars.DataFrame:
    """The paper's real flights in the same columns, with the latencies that training really had.

    Raises:
        InputError: the folder lacks `flights.csv`, or that lacks a column.
    """
    try:
        flights = read_published_flights(folder)
        trained = np.floor_divide(flights["latency"].to_numpy(), AUTHORS_STEP) * AUTHORS_STEP
        labels = [
            polars.lit(0).alias("seed"),
            polars.lit(AUTHORS_RATE).alias("training_rate"),
            polars.Series("latency", trained),
            polars.col("policy").alias("number"),
            polars.lit(REAL).alias("reality"),
        ]
        return flights.with_columns(labels).select(*POLICY, "duration")
    except polars.exceptions.PolarsError as error:
        raise InputError(
            f"{folder / 'flights.csv'}: not the authors' flights ({str(error).splitlines()[0]})."
        ) from error


def average_policies(flights: polars.DataFrame, nominal: Parameters) -> polars.DataFrame:
    """Flights' means, a row a policy and reality.

    `trained` is the total lag of the drone that it was trained for [s].
    """
    durations = flights.with_columns(polars.col("duration").clip(upper_bound=MAX_DURATION_S))
    means = [
        polars.col("duration").mean(),
        (polars.col("duration") >= MAX_DURATION_S).mean().alias("share"),
        polars.len().alias("flights"),
    ]
    rows = durations.group_by(POLICY, maintain_order=True).agg(*means)
    drones = (
        replace(nominal, **constants)
        for constants in rows.select("motor_time_constant", "latency").iter_rows(named=True)
    )
    return rows.with_columns(
        polars.Series("trained", [total_lag(drone) for drone in drones], polars.Float64)
    )


def join_tables(tables: Sequence[polars.DataFrame]) -> polars.DataFrame:
    """Flights of all tables; one that stands in several counts once.

    Raises:
        InputError: tables of one seed tell a flight differently.
    """
    flights = polars.concat(
        [table.select(*POLICY, "trial", "duration") for table in tables]
    ).unique(maintain_order=True)
    twice = flights.filter(flights.select(*POLICY, "trial").is_duplicated())
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


def group_policies(policies: polars.DataFrame, lags: Mapping[str, float]) -> list[Data]:
    """Groups policies by place and training rate.

    Matching rates together, and each rate of training that is not its structure's own.

    A structure whose own rate that is, as PWM's is 100 Hz, is in both.
    """
    own = polars.col("control").replace_strict(
        {kind: own_rate(kind) for kind in CONTROLS}, return_dtype=polars.Int64
    )
    matches = polars.col("training_rate") == own
    groups = []
    for (name,), here in policies.group_by("reality", maintain_order=True):
        matched, place = here.filter(matches), str(name)
        if matched.height and place != REAL:
            groups.append(Data(place, MATCHING, lags[place], matched))
        for rate in (
            [AUTHORS_RATE]
            if place == REAL
            else here.filter(~matches)["training_rate"].unique().sort()
        ):
            groups.append(
                Data(
                    place,
                    f"trained at {rate} Hz",
                    lags[place],
                    here.filter(polars.col("training_rate") == rate),
                )
            )
    return groups
