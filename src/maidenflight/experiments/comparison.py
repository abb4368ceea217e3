"""Policies compared by their flights: which flew best, and which are in a limit cycle."""

from collections.abc import Collection

import polars

from maidenflight.experiments.recovery import LASTS
from maidenflight.experiments.transfer import LIMIT_CYCLE


def summarize(flights: polars.DataFrame) -> polars.DataFrame:
    """Returns flights, those that reached the time limit, mean duration [s] and error [m].

    A row a policy and reality.

    Args:
        flights: the table of `transfer`.
    """
    return flights.group_by("policy", "reality", maintain_order=True).agg(
        polars.len().alias("flights"),
        (polars.col("end_reason") == LASTS).sum().alias("time_limit"),
        polars.col("duration").mean(),
        polars.col("position_error").mean(),
        polars.col("command_change").mean(),
        polars.col("at_limits").mean(),
    )


def best_in_transfer(flights: polars.DataFrame, among: Collection[str]) -> str | None:
    """Returns the policy that flew longest and, among equals, closest; None among none.

    One in a limit cycle is chosen for want of another only.

    Args:
        flights: the table of `transfer`.
        among: policies to choose from.
    """
    if not among:
        return None
    order = (
        flights.filter(polars.col("policy").is_in(among))
        .group_by("policy")
        .agg(
            polars.col("duration").mean(),
            polars.col("position_error").mean(),
            (polars.col("command_change").mean() > LIMIT_CYCLE).alias("limit_cycle"),
        )
    )
    keys = ["duration", "limit_cycle", "position_error", "policy"]
    return order.sort(keys, descending=[True, False, False, False])["policy"][0]


def best_in_envelope(summary: polars.DataFrame, among: Collection[str]) -> str | None:
    """Returns the policy with the widest envelope, its mean share of each axis; None among none.

    Args:
        summary: what `envelope.summary` returns.
        among: policies to choose from.
    """
    if not among:
        return None
    share = (polars.col("envelope").fill_nan(0.0) / polars.col("hardest")).mean()
    order = (
        summary.filter(polars.col("policy").is_in(among))
        .group_by("policy", maintain_order=True)
        .agg(share.alias("share"))
    )
    return order.sort("share", descending=True, maintain_order=True)["policy"][0]


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
