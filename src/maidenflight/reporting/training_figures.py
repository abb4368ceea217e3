"""Learning curves of policies that are trained side by side."""

import numpy as np
import polars

from maidenflight.errors import InputError
from maidenflight.reporting import charts
from maidenflight.reporting.charts import Entry, Figure, Spec

SCORES = {
    "episode_return": ("return", 1.0),
    "survival": ("episodes survived [%]", 100.0),
    "position_error": ("position error [cm]", 100.0),
}
"""Label and shown value per SI value of a policy's scores."""
_STEPS = "simulated steps [million]"


def learning_curves(scores: polars.DataFrame) -> Figure:
    """A panel a score: the policies' mean, from the worst to the best, and each.

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
    several = scores["policy"].n_unique() > 1
    legend = [Entry("mean of the policies" if several else "the policy", "blue", "line", "mean")]
    if several:
        legend += [
            Entry("each policy", "blue", "thin", "each"),
            Entry("from the worst to the best", "blue", "area", "range"),
        ]
    panels = [_panel(scores, score, several) for score in SCORES]
    return Figure("Learning curves", panels, legend, least=250)


def _panel(scores: polars.DataFrame, score: str, several: bool) -> Spec:
    label, scale = SCORES[score]
    places, values = _by_policy(scores, score)
    shown = scale * values
    known = np.isfinite(shown).any(axis=1)
    rows = [
        {"series": "each", "policy": f"policy {policy}", "x": place, "y": value}
        for policy, column in enumerate(shown.T, 1)
        for place, value in zip(places, column, strict=True)
        if several
    ]
    for place, each in zip(places[known], shown[known], strict=True):
        rows.append({"series": "mean", "policy": "mean", "x": place, "y": np.nanmean(each)})
        ends = {"y": np.nanmin(each), "high": np.nanmax(each)}
        rows += [{"series": "range", "policy": "range", "x": place, **ends}] if several else []
    blue, x = charts.paint("blue"), charts.number("x", _STEPS)
    y = charts.number("y", scale={"zero": False})
    told = charts.tooltip({"policy": "", "x": _STEPS, "y": label})
    layers: list[Spec] = [
        {
            "transform": [{"filter": "datum.series === 'range'"}],
            "mark": {"type": "area", "color": blue, "opacity": 0.18},
            "encoding": {"x": x, "y": y, "y2": {"field": "high"}},
        },
        {
            "transform": [{"filter": "datum.series !== 'range'"}],
            "mark": {"type": "line", "color": blue},
            "encoding": {
                "x": x,
                "y": y,
                "detail": {"field": "policy"},
                "size": {
                    "condition": {"test": "datum.series === 'mean'", "value": 2.5},
                    "value": 1,
                },
                "opacity": {
                    "condition": {"test": "datum.series === 'mean'", "value": 1},
                    "value": 0.5,
                },
            },
        },
        {
            "transform": [{"filter": "datum.series !== 'range'"}],
            "mark": {"type": "point", "color": blue, "filled": True, "opacity": 0, "size": 120},
            "encoding": {"x": x, "y": y, "tooltip": told},
        },
    ]
    return charts.panel(charts.rows(rows), layers, title=label, height=180)


def _by_policy(scores: polars.DataFrame, score: str) -> tuple[np.ndarray, np.ndarray]:
    """E places [million steps], and a score of P policies there, (E, P); NaN if not known."""
    numbers = scores.with_columns(polars.col("steps", score).cast(polars.Float64)).filter(
        polars.col("steps").is_finite()
    )
    table = numbers.pivot(on="policy", index="steps", values=score, aggregate_function="last").sort(
        "steps"
    )
    values = table.drop("steps").fill_null(float("nan")).to_numpy()
    return 1e-6 * table["steps"].to_numpy(), np.where(np.isfinite(values), values, np.nan)
