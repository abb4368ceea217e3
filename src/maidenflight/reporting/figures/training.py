"""Learning curves of policies that are trained side by side."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import polars

from maidenflight.errors import InputError
from maidenflight.reporting.figures import charts
from maidenflight.reporting.figures.charts import Entry, Figure, Spec

SCORES = {
    "episode_return": ("return", 1.0),
    "survival": ("episodes survived [%]", 100.0),
    "position_error": ("position error [cm]", 100.0),
}
"""Label and displayed value per SI value of a policy's scores."""
_OVER = {"steps": ("simulated steps [million]", 1e-6), "seconds": ("time [s]", 1.0)}
"""The same of what they are drawn over."""
_LEAST = {"survival": 20.0, "position_error": 1.0}
"""Least spans of displayed scores: below them curves differ by single episodes."""


def learning_curves(scores: polars.DataFrame) -> Figure:
    """Returns a panel a score: the policies' mean, from the worst to the best, and each.

    Args:
        scores: rows of `policy`, `steps` and the scores, as in training.csv; all policies are
            scored together.

    Raises:
        InputError: nothing to draw, or a column is missing.
    """
    missing = [name for name in ("policy", "steps", *SCORES) if name not in scores.columns]
    if missing or scores.height == 0:
        raise InputError(
            f"no learning curves to draw; {f'no column {missing[0]}' if missing else 'no rows'}."
        )
    panels = [panel(scores, score, SCORES[score][0]) for score in SCORES]
    return Figure("Learning curves", panels, legend(scores), least=250)


def legend(scores: polars.DataFrame) -> list[Entry]:
    """Returns the entries for the panels of these scores."""
    if scores["policy"].n_unique() == 1:
        return [Entry("the policy", "blue", "line", "mean")]
    return [
        Entry("mean of the policies", "blue", "line", "mean"),
        Entry("each policy", "blue", "thin", "each"),
        Entry("from the worst to the best", "blue", "area", "range"),
    ]


def panel(scores: polars.DataFrame, score: str, title: str, over: str = "steps") -> Spec:
    """Returns the curves of a score.

    Args:
        scores: see `learning_curves`.
        score: a name of `SCORES`.
        title: above the panel.
        over: the column that runs to the right, `steps` or `seconds`.
    """
    label, scale = SCORES[score]
    several = scores["policy"].n_unique() > 1
    places, values = _by_policy(scores, score, over)
    drawn = scale * values
    is_finite = np.isfinite(drawn).any(axis=1)
    rows = [
        {"series": "each", "policy": f"policy {policy}", "x": step, "y": value}
        for policy, column in enumerate(drawn.T, 1)
        for step, value in zip(places, column, strict=True)
        if several
    ]
    for step, each in zip(places[is_finite], drawn[is_finite], strict=True):
        rows.append({"series": "mean", "policy": "mean", "x": step, "y": np.nanmean(each)})
        ends = {"y": np.nanmin(each), "high": np.nanmax(each)}
        rows += [{"series": "range", "policy": "range", "x": step, **ends}] if several else []
    blue, x = charts.paint("blue"), charts.number("x", _OVER[over][0])
    y = charts.number("y", **charts.within(*_span(score, drawn)))
    tooltip = charts.tooltip({"policy": "", "x": _OVER[over][0], "y": label})
    curves = "datum.series !== 'range'"
    size, opacity = (
        {"condition": {"test": "datum.series === 'mean'", "value": thick}, "value": thin}
        for thick, thin in ((2.5, 1), (1, 0.5))
    )
    band = {"type": "area", "color": blue, "opacity": 0.18}
    dot = {"type": "point", "color": blue, "filled": True, "opacity": 0, "size": 120}
    look = {"detail": {"field": "policy"}, "size": size, "opacity": opacity}
    layers = [
        charts.layer("datum.series === 'range'", band, x=x, y=y, y2={"field": "high"}),
        charts.layer(curves, {"type": "line", "color": blue}, x=x, y=y, **look),
        charts.layer(curves, dot, x=x, y=y, tooltip=tooltip),
    ]
    return charts.panel(charts.rows(rows), layers, title=title, height=180)


def _span(score: str, values: Any) -> tuple[float, float]:
    """The ends of a score's axis; those of a share within 0 to 100 %, and room for a line there."""
    low, high = charts.margin(values, _LEAST.get(score, 0.0))
    if score != "survival":
        return low, high
    shift = max(0.0, -low) - max(0.0, high - 100.0)
    return max(low + shift, 0.0) - 0.5, min(high + shift, 100.0) + 0.5


def compared_curves(runs: Mapping[str, polars.DataFrame], colours: Mapping[str, str]) -> Figure:
    """Returns a panel a score: the mean over the policies of each run.

    Args:
        runs: scores as of `learning_curves`, by the run's name.
        colours: of each run, by its name.
    """
    panels = []
    for score, (label, scale) in SCORES.items():
        rows: list[Spec] = []
        for name, scores in runs.items():
            places, values = _by_policy(scores, score, "steps")
            known = np.isfinite(values).any(axis=1)
            means = scale * np.nanmean(values[known], axis=1)
            rows += [
                {"series": name, "x": step, "y": mean}
                for step, mean in zip(places[known], means, strict=True)
            ]
        span = _span(score, [row["y"] for row in rows])
        x = charts.number("x", _OVER["steps"][0])
        y = charts.number("y", **charts.within(*span))
        layer = charts.layer("", {"type": "line"}, x=x, y=y, color=charts.coloured(colours))
        panels.append(charts.panel(charts.rows(rows), [layer], title=label))
    legend = [Entry(name, colours[name], "line", name) for name in runs]
    return Figure("Learning curves, means of the policies", panels, legend, least=250)


def _by_policy(scores: polars.DataFrame, score: str, over: str) -> tuple[np.ndarray, np.ndarray]:
    """E places, as displayed, and a score of P policies there, (E, P); NaN if not known."""
    numbers = scores.with_columns(polars.col(over, score).cast(polars.Float64))
    known = numbers.filter(polars.col(over).is_finite()).sort(over, maintain_order=True)
    table = known.pivot(on="policy", index=over, values=score, aggregate_function="last")
    values = table.drop(over).fill_null(float("nan")).to_numpy()
    return _OVER[over][1] * table[over].to_numpy(), np.where(np.isfinite(values), values, np.nan)
