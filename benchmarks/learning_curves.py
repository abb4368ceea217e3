"""Learning curves of policies that are trained side by side, as an SVG file for a page."""

from collections.abc import Mapping, Sequence

import numpy as np
import polars

from maidenflight.errors import InputError
from maidenflight.reporting import svg
from maidenflight.reporting.svg import Panel

SCORES = {
    "episode_return": ("return", 1.0),
    "survival": ("episodes survived [%]", 100.0),
    "position_error": ("position error [cm]", 100.0),
}
"""Label and shown value per SI value of a policy's scores."""
OVER = {
    "steps": ("simulated steps [million]", 1e-6),
    "seconds": ("time [s]", 1.0),
    "update": ("updates", 1.0),
}
"""The same of what they are drawn over."""
NARROWEST = 240.0
"""Width of a panel [px]; where one would be narrower, fewer stand side by side."""


def learning_curves(
    trainings: Mapping[str, polars.DataFrame],
    scores: Sequence[str] = tuple(SCORES),
    over: str = "steps",
    width: float = 720,
    title: str = "Learning curves",
) -> str:
    """A panel a training and score: mean, range and each of its policies.

    Args:
        trainings: by name, rows of `policy`, the scores and `over`, as in training.csv; all
            policies of a training are scored together.
        scores: which, names in `SCORES`.
        over: what runs to the right, a name in `OVER`.
        width: of the picture [px].
        title: of the picture.

    Raises:
        InputError: nothing to draw, or a column is missing.
    """
    if not trainings or not scores:
        raise InputError("no learning curves to draw; expected a training and a score of it.")
    for name, rows in trainings.items():
        missing = [column for column in ("policy", over, *scores) if column not in rows.columns]
        if missing or rows.height == 0:
            raise InputError(
                f"{name}: no learning curves to draw; "
                f"{f'no column {missing[0]}' if missing else 'no rows'}."
            )
    most = max(rows["policy"].n_unique() for rows in trainings.values())
    legend, tall = svg.legend(svg.TITLE, width, _legend(most))
    columns = min(max(int(width // NARROWEST), 1), len(trainings) * len(scores))
    side, high, top = width / columns, 170.0, svg.TITLE + tall + 32
    parts = [legend]
    for number, (name, score) in enumerate((name, score) for name in trainings for score in scores):
        label, scale = SCORES[score]
        label_parts = [
            *([name] if len(trainings) > 1 else []),
            *([label] if len(scores) > 1 or len(trainings) == 1 else []),
        ]
        places, policies = _by_policy(trainings[name], score, over)
        values = scale * policies
        x = (0.0, 1.02 * float(np.max(places, initial=0.0)) or 1.0)
        finite = values[np.isfinite(values)]
        y = svg.margin(finite) if finite.size else (0.0, 1.0)
        panel = Panel(
            number % columns * side + 48,
            top + number // columns * (high + 80),
            side - 60,
            high,
            x,
            y,
        )
        axes = svg.axes(panel, OVER[over][0], "", few=4)
        parts += [svg.text(panel.left, panel.top - 9, ": ".join(label_parts), "strong"), axes[0]]
        parts.append(
            svg.framed(panel, [axes[1], *_curves(panel, places, values)], f"{name} {score}")
        )
    rows = -(-len(trainings) * len(scores) // columns)
    return svg.picture(width, top + rows * (high + 80) - 28, title, parts)


def _legend(policies: int) -> list[tuple[str, str]]:
    if policies == 1:
        return [(svg.stroke("M0 6H24", "line", "blue"), "the policy")]
    return [
        (svg.stroke("M0 6H24", "line", "blue"), "mean of the policies"),
        (svg.stroke("M0 6H24", "thin faded", "blue"), "each policy"),
        (svg.fill("M0 0H24V12H0Z", "faint", "blue"), "from the worst to the best"),
    ]


def _by_policy(rows: polars.DataFrame, score: str, over: str) -> tuple[np.ndarray, np.ndarray]:
    """E places, as they are shown, and a score of P policies there, (E, P); NaN if not known."""
    numbers = rows.with_columns(polars.col(over, score).cast(polars.Float64)).filter(
        polars.col(over).is_finite()
    )
    table = numbers.pivot(on="policy", index=over, values=score, aggregate_function="last").sort(
        over
    )
    values = table.drop(over).fill_null(float("nan")).to_numpy()
    return OVER[over][1] * table[over].to_numpy(), np.where(np.isfinite(values), values, np.nan)


def _curves(panel: Panel, places: np.ndarray, values: np.ndarray) -> list[str]:
    """Where a score is not finite, mean and range are those of the others.

    Where none is, all lines are broken.
    """
    known = np.isfinite(values).any(axis=1)
    shown = values[known]
    parts = []
    if values.shape[1] > 1 and known.any():
        parts.append(
            svg.band(
                panel, places[known], np.nanmin(shown, axis=1), np.nanmax(shown, axis=1), "blue"
            )
        )
        parts += [svg.line(panel, places, policy, "thin faded", "blue") for policy in values.T]
    mean = np.full(len(places), np.nan)
    mean[known] = np.nanmean(shown, axis=1)
    return [*parts, svg.line(panel, places, mean, "", "blue")]
