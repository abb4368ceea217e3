"""Policies compared by their flights: which is best, which are near a guard or in a limit cycle."""

import math
from collections.abc import Collection

import polars

from maidenflight.experiments.transfer import LIMIT_CYCLE
from maidenflight.simulator.tasks.failures import BACKUP, ERRORS, LARGEST, REACHED

RULE = (
    "longest mean flight, or farthest along the axes; among those within 2 % of it no limit cycle, "
    "then the smallest mean distance from the set-point, by the drone's own estimate"
)
"""By which the best of several policies is chosen, whatever they flew."""
ALIKE = 0.98
"""Share of the longest mean flight from which flights are as long."""
LEAST_TILT_MARGIN = 8.0
"""Margin to the guard of the tilt below which a policy is reported [deg]; ours."""


def summarize(flights: polars.DataFrame) -> polars.DataFrame:
    """Returns flights, those that reached the time limit, mean duration [s] and error [m].

    A row a policy and reality, with the error by the drone's own estimates [m], and the largest
    tilt [rad], body rate [rad/s] and distance [m].

    Args:
        flights: the table of `transfer`.
    """
    return flights.group_by("policy", "reality", maintain_order=True).agg(
        polars.len().alias("flights"),
        (polars.col("end_reason") == REACHED).sum().alias("time_limit"),
        polars.col("duration").mean(),
        polars.col(*ERRORS).mean(),
        polars.col("command_change").mean(),
        polars.col("at_limits").mean(),
        polars.col(LARGEST).max(),
    )


def choose_best(flights: polars.DataFrame, among: Collection[str]) -> str | None:
    """Returns the best policy by `RULE`; None among none.

    Args:
        flights: a row a flight with policy and duration, and estimated_error and command_change
            where they are known: the tables of `transfer`, `predict_flight_times` and `envelope`.
        among: policies to choose from.
    """
    if not among:
        return None
    known = [name for name in ("command_change", "estimated_error") if name in flights.columns]
    means = (
        flights.filter(polars.col("policy").is_in(among))
        .group_by("policy", maintain_order=True)
        .agg(polars.col("duration", *known).mean())
    )
    longest = means.filter(polars.col("duration") >= ALIKE * polars.col("duration").max())
    cycles = polars.col("command_change") > LIMIT_CYCLE
    keys = [cycles if name == "command_change" else polars.col(name) for name in known]
    return longest.sort(*keys, -polars.col("duration"), maintain_order=True)["policy"][0]


def describe_margins(summary: polars.DataFrame) -> list[str]:
    """Returns a sentence on policies whose flights lasted, but tilted nearly as far as a guard.

    Args:
        summary: what `summarize` or `flight_times.summary` returns.
    """
    limit = math.degrees(BACKUP.tilt)
    tilt = polars.col("largest_tilt").degrees()
    near = summary.filter((tilt > limit - LEAST_TILT_MARGIN) & (tilt <= limit))
    if near.is_empty():
        return []
    worst = math.degrees(max(near["largest_tilt"]))
    names = ", ".join(near["policy"].unique(maintain_order=True))
    return [
        f"{names}: tilts of up to {worst:.0f} deg. A guard of the drone ends flights at "
        f"{limit:.0f} deg; a margin of {LEAST_TILT_MARGIN:g} deg is advised."
    ]


def describe_limit_cycles(summary: polars.DataFrame) -> list[str]:
    """Returns a sentence on each policy and reality whose motors are thrown between their limits.

    Args:
        summary: what `summarize` returns.
    """
    return [
        f"{row['policy']} in {row['reality']} changes its commands by {row['command_change']:.2f} "
        f"of full thrust in 10 ms, {100 * row['at_limits']:.0f} % of them at a limit: a limit "
        "cycle, which wears motors and seldom survives on a real drone. Identify the drone from "
        "its flights, or train with its latency."
        for row in summary.iter_rows(named=True)
        if row["command_change"] > LIMIT_CYCLE
    ]
