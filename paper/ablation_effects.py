"""Effects of the ablations on zero-shot flights: 95 % intervals over policies, table and chart."""

import warnings
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import polars
from ablation_variants import BASELINE, ITSELF, PARTS, POSTERIOR, TRIM
from jaxtyping import Float
from scipy import stats

from maidenflight.reporting.figures import charts, intervals
from maidenflight.reporting.figures.charts import Entry, Figure, Spec


class Measure(NamedTuple):
    """A column of `flights.csv`, as it is shown."""

    column: str
    title: str
    unit: str
    scale: float
    decimals: int


MEASURES = (
    Measure("duration", "flight time", "s", 1.0, 1),
    Measure("position_error", "distance", "cm", 100.0, 1),
    Measure("beyond", "actions beyond 1", "%", 100.0, 1),
    Measure("change", "change of u", "%", 100.0, 2),
    Measure("at_limits", "u at 0 or 1", "%", 100.0, 1),
)


def average_policies(flights: polars.DataFrame) -> polars.DataFrame:
    """Means of a policy's flights in a reality, a row a policy.

    All but the duration are means over time.
    """
    weight = polars.col("duration")
    others = [
        ((polars.col(each.column) * weight).sum() / weight.sum()).alias(each.column)
        for each in MEASURES[1:]
    ]
    return flights.group_by("control", "variant", "reality", "policy", maintain_order=True).agg(
        *others, weight.mean().alias("duration")
    )


def find_effects(flights: polars.DataFrame) -> polars.DataFrame:
    """Of everything that was changed, in the order of the flights.

    Returns:
        control, variant, reality, measure, policies, mean, effect, low, high (95 % interval), in
        the units of `MEASURES`. A variant's effect is the difference to the baseline of its control
        structure in the same reality (Welch's interval, policies are the sample); that of drones
        which resemble the one trained for is the mean difference to the flights of the same
        policies on that one. An interval is not a number where no policy differs from another.
    """
    means, rows = average_policies(flights), []
    for structure, name, reality in (
        means.select("control", "variant", "reality").unique(maintain_order=True).iter_rows()
    ):
        own = means.filter(
            (polars.col("control") == structure)
            & (polars.col("variant") == name)
            & (polars.col("reality") == reality)
        )
        paired = reality in (POSTERIOR, TRIM, *PARTS)
        base = means.filter(
            (polars.col("control") == structure)
            & (polars.col("variant") == BASELINE)
            & (polars.col("reality") == (ITSELF if paired else reality))
        )
        for each in MEASURES:
            values, others = (each.scale * frame[each.column].to_numpy() for frame in (own, base))
            low, high = (
                (np.nan, np.nan)
                if name == BASELINE and not paired
                else _interval(values, others, paired)
            )
            effect = float(values.mean() - others.mean())
            columns = {
                "control": structure,
                "variant": name,
                "reality": reality,
                "measure": each.column,
                "policies": len(values),
            }
            rows.append(
                {
                    **columns,
                    "mean": float(values.mean()),
                    "effect": effect,
                    "low": low,
                    "high": high,
                }
            )
    return polars.DataFrame(rows)


def _interval(
    values: Float[np.ndarray, "n"], others: Float[np.ndarray, "m"], paired: bool
) -> tuple[float, float]:
    """Of the difference of means."""
    with warnings.catch_warnings():  # of policies that do not differ, which give no interval
        warnings.simplefilter("ignore", RuntimeWarning)
        effects: Any = (
            stats.ttest_rel(values, others)
            if paired
            else stats.ttest_ind(values, others, equal_var=False)
        )
        low, high = effects.confidence_interval(0.95)
    return (float(low), float(high)) if low < high else (np.nan, np.nan)


COLOURS = ("blue", "orange", "green", "purple")
COLUMN = 132
"""Width of a panel [px]."""
NOTE = (
    "Dots: difference of means over policies; whiskers: its 95 % interval. Left of the line is "
    "less than without the change."
)


def draw_chart(table: polars.DataFrame, drone: str) -> Figure:
    """Effects with intervals: blocks by structure and kind of change, panels by measure."""
    realities = _shared_realities(table)
    changed = table.filter(
        (polars.col("variant") != BASELINE) | ~polars.col("reality").is_in(realities)
    )
    colours = dict(zip(realities, COLOURS, strict=False))
    legend = [
        Entry("on the drone itself" if name == ITSELF else f"in {name}", colours[name], "bar")
        for name in realities
    ]
    ranges = {
        each.column: charts.margin([0.0, *_ends(changed.filter(measure=each.column))])
        for each in MEASURES
    }
    panels = []
    for structure in table["control"].unique(maintain_order=True):
        own = changed.filter(control=structure)
        for column, block, words in (
            ("variant", own.filter(polars.col("variant") != BASELINE), "trained otherwise"),
            ("reality", own.filter(variant=BASELINE), "flown on other drones"),
        ):
            title = f"{structure.replace('_', ' ')}: {words}"
            cells = list(_block(block, column, ranges, colours)) if block.height else []
            head = {"text": title, "frame": "group"}
            panels += [{"title": head, "hconcat": cells, "spacing": 14}] if cells else []
    title = f"What zero-shot flights depend on: drone {drone}"
    return Figure(title, panels, legend, columns=1)


def _shared_realities(table: polars.DataFrame) -> list[str]:
    """Realities in which all variants flew."""
    return (
        table.filter(polars.col("variant") != BASELINE)["reality"]
        .unique(maintain_order=True)
        .to_list()
    )


def _ends(rows: polars.DataFrame) -> Float[np.ndarray, "n"]:
    return rows.select("effect", "low", "high").to_numpy().ravel()


def _block(
    block: polars.DataFrame,
    column: str,
    ranges: Mapping[str, tuple[float, float]],
    colours: Mapping[str, str],
) -> Iterator[Spec]:
    """A panel a measure, a row a name in a column, side by side."""
    names = block[column].unique(maintain_order=True).to_list()
    shifts = np.linspace(-0.2, 0.2, len(colours)) if len(colours) > 1 else [0.0]
    # Flights on other drones are compared with those on the drone itself.
    places = dict(zip(colours, shifts, strict=True)) if column == "variant" else {ITSELF: 0.0}
    nothing = {"type": "rule", "strokeWidth": 1.2}
    for number, each in enumerate(MEASURES):
        marks: list[Spec] = []
        for row in block.filter(measure=each.column).iter_rows(named=True):
            reality = row["reality"] if column == "variant" else ITSELF
            common = {"row": names.index(row[column]), "shift": float(places[reality])}
            common["colour"] = charts.paint(colours[reality])
            if np.isfinite([row["low"], row["high"]]).all():
                whisker = {**common, "kind": "whisker", "x": row["low"], "x2": row["high"]}
                marks.append(whisker)
            marks.append({**common, "kind": "dot", "x": row["effect"]})
        left = names if number == 0 else [""] * len(names)
        x = charts.number("x", f"{each.title} [{each.unit}]", **charts.within(*ranges[each.column]))
        panel = intervals.rows(
            [(name, "") for name in left],
            marks,
            {**x, "axis": {"tickCount": 4}},
            across=[(0.0, nothing)],
        )
        yield {**panel, "width": COLUMN}


def summarize(table: polars.DataFrame) -> polars.DataFrame:
    """One row per control structure, variant and reality.

    Policies, mean flight time, and for each measure the mean and the effect with its interval.
    """
    rows: dict[tuple[str, str, str], dict[str, Any]] = {}
    plain = {each.column: each for each in MEASURES}
    for row in table.iter_rows(named=True):
        each = plain[row["measure"]]
        entries = rows.setdefault(
            (row["control"], row["variant"], row["reality"]),
            {
                **{name: row[name] for name in ("control", "variant", "reality")},
                "n": row["policies"],
            },
        )
        mean, effect, low, high = (
            f"{row[name]:+.{each.decimals}f}" for name in ("mean", "effect", "low", "high")
        )
        unchanged = row["variant"] == BASELINE and row["reality"] not in (POSTERIOR, TRIM, *PARTS)
        # Where policies do not differ among themselves there is nothing to tell an interval from.
        interval = f" ({low} to {high})" if np.isfinite([row["low"], row["high"]]).all() else ""
        entries[f"{each.title} [{each.unit}]"] = mean.removeprefix("+") + (
            "" if unchanged else f"   {effect}{interval}"
        )
    return polars.DataFrame(list(rows.values()))
