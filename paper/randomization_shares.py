"""Shares of flights that reach the longest time, by randomization: intervals, tables, chart."""

import math
import warnings
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import polars
from jaxtyping import Float
from scipy import stats

from maidenflight.reporting.figures import charts
from maidenflight.reporting.figures.charts import Entry, Figure, Spec

BAR = 0.95
"""Share of flights that shall reach the time limit."""
COLOURS = {"none": "purple", "box": "blue", "posterior": "green", "recipe": "orange"}
"""Randomizations, in the order of the table."""
OLD = " 2021.10"
"""What the names of places end in where policies fly as the authors' drone ran them, not as they
were trained."""


class Interval(NamedTuple):
    """A number and the ends of its 95 % interval.

    They are not numbers where there is one policy.
    """

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return (
            f"{self.value:.2f}"
            if math.isnan(self.low)
            else f"{self.value:.2f} [{self.low:.2f}, {self.high:.2f}]"
        )


def average(values: Float[np.ndarray, "n"]) -> Interval:
    """Mean over policies, with Student's interval.

    Policies that are all equal say nothing of how others differ: it has no width.
    """
    if len(values) < 2 or np.ptp(values) == 0:
        end = math.nan if len(values) < 2 else float(values[0])
        return Interval(float(values[0]), end, end)
    low, high = stats.t.interval(0.95, len(values) - 1, np.mean(values), stats.sem(values))
    return Interval(float(np.mean(values)), float(low), float(high))


def compare_means(first: Float[np.ndarray, "n"], second: Float[np.ndarray, "m"]) -> Interval:
    """How much larger the mean of the second policies is, with Welch's interval.

    None where no policy differs from its like.
    """
    value = float(np.mean(second) - np.mean(first))
    if min(len(first), len(second)) < 2 or np.ptp(first) == np.ptp(second) == 0:
        return Interval(value, math.nan, math.nan)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Precision loss")  # one side's policies may all be equal
        low, high = stats.ttest_ind(second, first, equal_var=False).confidence_interval()
    return Interval(value, float(low), float(high))


def average_policies(flights: polars.DataFrame, longest: float) -> polars.DataFrame:
    """One row per policy and place.

    Columns: control, randomization, place, number, flights, share that reached the longest time,
    mean duration [s].
    """
    duration = polars.col("duration")
    rows_of_text = [
        polars.len().alias("flights"),
        (duration >= longest - 1e-6).mean().alias("share"),
        duration.mean().alias("mean"),
    ]
    return flights.group_by("control", "randomization", "place", "number", maintain_order=True).agg(
        *rows_of_text
    )


def summarize(flights: polars.DataFrame, longest: float) -> polars.DataFrame:
    """One row per control structure, place and randomization.

    Shares of flights that reached the longest time, times, and why others ended.
    """
    rows = []
    for (kind, place, randomization), part in flights.group_by(
        "control", "place", "randomization", maintain_order=True
    ):
        policies = average_policies(part, longest)
        short = part.filter(polars.col("duration") < longest - 1e-6)["end_reason"].value_counts(
            sort=True
        )
        share, mean = (average(policies[name].to_numpy()) for name in ("share", "mean"))
        rows.append(
            {
                "control": kind,
                "place": place,
                "randomization": randomization,
                "policies": policies.height,
                "flights": part.height,
                "share of 20 s": str(
                    Interval(share.value, max(share.low, 0.0), min(share.high, 1.0))
                ),
                "worst policy": policies["share"].min(),
                "mean [s]": mean.value,
                "most end by": f"{short['end_reason'][0]} ({short['count'][0]})"
                if short.height
                else "",
            }
        )
    return polars.DataFrame(rows)


def compare_randomizations(flights: polars.DataFrame, longest: float) -> polars.DataFrame:
    """One row per structure and place: the gain of each randomization over the one before."""
    rows = []
    for (kind, place), part in average_policies(flights, longest).group_by(
        "control", "place", maintain_order=True
    ):
        shares = {
            name: group["share"].to_numpy()
            for (name,), group in part.group_by("randomization", maintain_order=True)
        }
        pairs = {
            f"{second} - {first}": str(compare_means(shares[first], shares[second]))
            for first, second in pairwise(shares)
        }
        rows.append(
            {"control": kind, "place": place, "policies": min(map(len, shares.values())), **pairs}
        )
    return polars.DataFrame(rows)


def find_best_policies(flights: polars.DataFrame, longest: float) -> polars.DataFrame:
    """The policy of each control structure with the best worst share over all places.

    Its shares, and where it misses the requirement.

    Places of the authors' drone (`OLD`) do not count: policies are not trained for it.
    """
    policies = average_policies(flights.filter(~polars.col("place").str.ends_with(OLD)), longest)
    rows = []
    for (kind,), part in policies.group_by("control", maintain_order=True):
        least = part.group_by("randomization", "number", maintain_order=True).agg(
            polars.col("share").min().alias("least"), polars.col("share").mean().alias("all")
        )
        best = least.sort("least", "all", descending=True, maintain_order=True).row(0, named=True)
        own = part.filter(
            (polars.col("randomization") == best["randomization"])
            & (polars.col("number") == best["number"])
        )
        missed = [
            f"{row['place']} {row['share']:.2f}"
            for row in own.iter_rows(named=True)
            if row["share"] < BAR
        ]
        rows_of_text = "yes" if not missed else f"no: {', '.join(missed)}"
        rows.append(
            {
                "control": kind,
                "policy": f"{best['randomization']} {best['number']}",
                "least share": best["least"],
                "meets it": rows_of_text,
            }
        )
    return polars.DataFrame(rows)


STEP, HIGH = 84, 170
"""Of a place's column and of a panel [px]."""


def draw_chart(flights: polars.DataFrame, longest: float) -> Figure:
    """Share of flights that reached the longest time: a dot a policy, a line the mean.

    A panel per control structure, a column per place, a colour per randomization.
    """
    policies = average_policies(flights, longest)
    kinds, places = (
        policies[name].unique(maintain_order=True).to_list() for name in ("control", "place")
    )
    places.sort(key=lambda place: place.endswith(OLD))
    chosen = [name for name in COLOURS if name in policies["randomization"]]
    legend = [Entry(name, COLOURS[name], "bar") for name in chosen]
    panels = [
        _panel(policies.filter(control=kind), kind, places, chosen, f"{longest:g} s reached [%]")
        for kind in kinds
    ]
    title = f"Share of flights that reach {longest:g} s"
    return Figure(title, panels, legend, columns=1)


def _panel(
    policies: polars.DataFrame, kind: str, places: list[str], chosen: list[str], label: str
) -> Spec:
    width, rows = 0.8 / len(chosen), []
    for (place, name), part in policies.group_by("place", "randomization", maintain_order=True):
        shares = 100 * part["share"].sort().to_numpy()
        middle = width * (chosen.index(str(name)) - (len(chosen) - 1) / 2)
        common = {"place": place, "colour": charts.paint(COLOURS[str(name)])}
        rows.append({**common, "kind": "mean", "shift": middle, "y": float(shares.mean())})
        across = middle + 0.22 * width * np.linspace(-1, 1, len(shares))
        rows += [
            {**common, "kind": "policy", "shift": shift, "y": share}
            for shift, share in zip(across, shares, strict=True)
        ]
    # The firmware stands below the place.
    lines = f"split(replace(datum.label, '{OLD}', '|{OLD.strip()}'), '|')"
    x = {"field": "place", "type": "nominal", "sort": places, "title": None}
    x |= {
        "scale": {"domain": places, "padding": 0},
        "axis": {"labelExpr": lines, "labelAngle": 0, "labelFlush": False},
    }
    y = charts.number("y", label, **charts.within(-4.0, 104.0))
    shared = {"x": x, "y": y, "color": {"field": "colour", "type": "nominal", "scale": None}}
    shared["xOffset"] = charts.number("shift", scale={"domain": [-0.5, 0.5]})
    bar = {"type": "rule", "strokeDash": [7, 4], "color": charts.paint("line")}
    mean = {"type": "tick", "orient": "horizontal", "size": 0.72 * width * STEP, "thickness": 2}
    layers: list[Spec] = [
        {"data": {"values": [{"y": 100 * BAR}]}, "mark": bar, "encoding": {"y": y}},
        charts.layer("mean", {**mean, "opacity": 0.6}, **shared),
        charts.layer("policy", {"type": "point", "filled": True, "opacity": 1}, **shared),
    ]
    panel = charts.panel(
        charts.rows(rows), layers, title=kind.replace("_", " "), height=HIGH, zooms=()
    )
    return {**panel, "width": STEP * len(places)}
