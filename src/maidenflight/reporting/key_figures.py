"""The few numbers that matter of a run, large, at the head of its page."""

from typing import NamedTuple

import numpy as np
import polars
from markupsafe import Markup

from maidenflight.experiments.transfer import MAX_DURATION_S
from maidenflight.reporting import lead, parameter_tables, text
from maidenflight.reporting.flight_figures import REACHED
from maidenflight.reporting.run import Run


class Figure(NamedTuple):
    """A number, its unit, what it is, and a note."""

    value: str
    unit: str
    label: str
    note: str


def key_figures(run: Run) -> list[Figure]:
    """The few numbers that matter."""
    return [*_of_parameters(run), *_of_training(run), *_of_predictions(run), *_of_flights(run)]


def _of_parameters(run: Run) -> list[Figure]:
    shown = []
    for name, words in lead.NAMES.items():
        if name in run.estimates:
            value, low, high = parameter_tables.estimate(run, name)
            label = Markup("{} {}").format(words, text.symbol(name))
            shown.append(Figure(value, text.unit(name), label, f"95 % interval {low} to {high}"))
    return shown


def _of_training(run: Run) -> list[Figure]:
    """Where nothing has flown yet, what training ended with."""
    if run.training is None or run.table is not None:
        return []
    last = run.training.filter(polars.col("steps") == polars.col("steps").max())
    best = last.sort("episode_return", descending=True).row(0, named=True)
    of = f"of {text.plural(last.height, 'policy')}" if last.height > 1 else "at the end of training"
    return [
        Figure(text.number(best["episode_return"], 3), "", "return of the best policy", of),
        Figure(
            f"{100 * best['survival']:.1f}",
            "%",
            "episodes that it survives",
            "in simulation, with randomization",
        ),
        Figure(
            f"{_centimetres(best['position_error'])}",
            "cm",
            "its mean position error",
            "mean over an episode",
        ),
    ]


def _of_flights(run: Run) -> list[Figure]:
    if run.table is None:
        return []
    reached = run.table.filter(polars.col("end_reason") == REACHED)
    limit = reached["duration"].to_numpy().max() if reached.height else MAX_DURATION_S
    simulated = bool(run.flights) and all(flight.simulated for flight in run.flights)
    word = "simulated test" if simulated else "test"
    median, error = (
        np.median(run.table["duration"].to_numpy()),
        _mean(run.table["position_error"].to_numpy()),
    )
    return [
        Figure(
            f"{reached.height}",
            f"of {run.table.height}",
            f"{word} flights reached {limit:g} s",
            lead.flown_on(run) or "zero-shot",
        ),
        Figure(
            f"{median:.1f}",
            "s",
            "their median flight time",
            f"longest allowed {limit:g} s",
        ),
        Figure(
            f"{_centimetres(error)}",
            "cm",
            "their mean position error",
            "mean over flights",
        ),
    ]


def _of_predictions(run: Run) -> list[Figure]:
    if run.prediction is None:
        return []
    times = (
        run.prediction.group_by("policy", maintain_order=True)
        .agg(polars.col("duration").mean())["duration"]
        .to_numpy()
    )
    reached = run.prediction.filter(polars.col("end_reason") == REACHED).height
    count = run.prediction.height
    return [
        Figure(
            f"{np.median(times):.1f}",
            "s",
            "predicted flight time on the identified drone",
            f"median over {text.plural(len(times), 'policy')}",
        ),
        Figure(
            f"{times.max():.1f}",
            "s",
            "that of the policy that flies longest",
            "mean over its flights",
        ),
        Figure(
            f"{100 * reached / count:.0f}",
            "%",
            "predicted flights reach the time limit",
            f"{reached} of {count}",
        ),
    ]


def _mean(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else float("nan")


def _centimetres(metres: float) -> str:
    return f"{metres * 100:.2f}" if np.isfinite(metres) else text.NOTHING
