"""Pictures of how well models predict flights: errors by horizon, and windows of flight."""

from collections.abc import Mapping, Sequence

import numpy as np
import polars

from maidenflight.identification.prediction import LOGGED, PERSISTENCE
from maidenflight.reporting import svg
from maidenflight.reporting.svg import Panel
from maidenflight.reporting.text import ERRORS, Shown

_LOOKS = (("", "orange"), ("dashed", "purple"), ("", "blue"), ("dashed", "green"))
"""How models are drawn, in their order: the identified drone and the paper's in the colours that
they have in the pictures of the delays."""
_SIGNALS = {
    "roll": Shown("roll", 180 / np.pi, "°"),
    "pitch": Shown("pitch", 180 / np.pi, "°"),
    "body_rate_x": Shown("roll rate", 1.0, "rad/s"),
    "body_rate_y": Shown("pitch rate", 1.0, "rad/s"),
    "position_z": Shown("height gained", 100.0, "cm"),
}
"""What is drawn of windows; heights count from a window's start."""


def horizons(errors: polars.DataFrame, width: float = 720) -> str:
    """How the errors of open-loop predictions grow, a line a model with its 95 % interval.

    The dotted line is the persistence baseline.

    Args:
        errors: as `prediction_error` gives them.
        width: of the picture [px].
    """
    names = errors["model"].unique(maintain_order=True).to_list()
    looks = _looks(names)
    legend, tall = svg.legend(svg.TITLE, width, _line_legend(looks))
    columns = 4 if width >= 900 else 2 if width >= 500 else 1
    side, high = width / columns, 200.0
    last = float(errors["horizon"].to_numpy().max())
    parts = [legend]
    for number, (column, (name, scale, unit)) in enumerate(ERRORS.items()):
        most = scale * float(errors[column].to_numpy().max())
        place = (
            number % columns * side + 40,
            svg.TITLE + tall + 32 + number // columns * (high + 74),
        )
        panel = Panel(
            *place, side - 52, high, (0.0, last * 1.02), svg.margin([0.0, most], floor=0.0)
        )
        axes = svg.axes(panel, "time ahead [s]", "", few=5)
        content = [axes[1]]
        for model in reversed(names):
            rows = errors.filter(polars.col("model") == model).sort("horizon")
            ahead = np.concatenate([[0.0], rows["horizon"].to_numpy()])
            middle, low, upper = (
                np.concatenate([[0.0], scale * rows[f"{column}{end}"].to_numpy()])
                for end in ("", "_low", "_high")
            )
            look, colour = looks[model]
            content.append(
                svg.band(panel, ahead, low, upper, colour)
                + svg.line(panel, ahead, middle, look, colour)
            )
            content.append(svg.dots(panel, ahead[1:], middle[1:], "spots", colour))
        parts += [
            svg.text(panel.left, panel.top - 9, f"{name} [{unit}]", "strong"),
            axes[0],
            svg.framed(panel, content, column),
        ]
    rows = -(-len(ERRORS) // columns)
    return svg.picture(
        width, svg.TITLE + tall + 20 + rows * (high + 74), "Errors over the time predicted", parts
    )


def windows(rows: polars.DataFrame, width: float = 720) -> str:
    """Logged flight and what models predict of its commands alone, window by window.

    A narrow picture shows the first windows only, and its title says how many of all.

    Args:
        rows: as `predicted_windows` gives them.
        width: of the picture [px].
    """
    known = rows["window"].unique(maintain_order=True).to_list()
    fit = known[: max(1, int((width - 50) // 145))]
    names = [name for name in rows["model"].unique(maintain_order=True).to_list() if name != LOGGED]
    looks = _looks(names)
    logged = (
        svg.dots(Panel(0, 0, 24, 12, (0, 4), (0, 2)), [0.5, 1.5, 2.5, 3.5], [1] * 4, "dots", "ink"),
        LOGGED,
    )
    legend, tall = svg.legend(svg.TITLE, width, [logged, *_line_legend(looks)])
    side, high, gap = (width - 46) / len(fit), 100.0, 34.0
    top = svg.TITLE + tall + 28
    shown = rows.filter(polars.col("window").is_in(fit)).with_columns(
        position_z=polars.col("position_z")
        - polars.col("position_z").first().over("window", "model")
    )
    last = float(shown["time"].to_numpy().max())
    parts = [legend]
    for line, (column, (name, scale, unit)) in enumerate(_SIGNALS.items()):
        y = svg.margin(scale * shown[column].to_numpy())
        for number, window in enumerate(fit):
            panel = Panel(
                46 + number * side,
                top + line * (high + gap),
                side - 10,
                high,
                (0.0, 1.02 * last),
                y,
            )
            part = shown.filter(polars.col("window") == window)
            below = "time [s]" if line == len(_SIGNALS) - 1 else None
            axes = svg.axes(panel, below, "", few=3, left=number == 0)
            content = [axes[1]]
            measured = part.filter(polars.col("model") == LOGGED)
            every = max(1, round(measured.height * 4.5 / panel.width))
            content.append(
                svg.dots(
                    panel,
                    measured["time"][::every],
                    scale * measured[column][::every].to_numpy(),
                    "dots",
                    "ink",
                )
            )
            for model in reversed(names):
                predicted = part.filter(polars.col("model") == model)
                content.append(
                    svg.line(
                        panel,
                        predicted["time"],
                        scale * predicted[column].to_numpy(),
                        *looks[model],
                    )
                )
            parts += [axes[0], svg.framed(panel, content, f"{column} {window}")]
        parts.append(svg.text(46, top + line * (high + gap) - 8, f"{name} [{unit}]", "strong"))
    some = f", {len(fit)} of {len(known)}" if len(fit) < len(known) else ""
    return svg.picture(
        width, top + len(_SIGNALS) * (high + gap) + 30, f"Predicted windows{some}", parts
    )


def _looks(names: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Look and colour of each model's line."""
    models = [name for name in names if name != PERSISTENCE]
    looks = {name: _LOOKS[number % len(_LOOKS)] for number, name in enumerate(models)}
    return looks | ({PERSISTENCE: ("dotted", "soft")} if PERSISTENCE in names else {})


def _line_legend(looks: Mapping[str, tuple[str, str]]) -> list[tuple[str, str]]:
    return [
        (svg.stroke("M0 6H24", f"line {look}".strip(), colour), name)
        for name, (look, colour) in looks.items()
    ]
