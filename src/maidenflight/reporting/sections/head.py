"""Title, badge, first sentences and key figures of the page.

A run is called simulated only where all its flights are known to be.
"""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
import polars
from markupsafe import Markup

from maidenflight.experiments.transfer import MAX_DURATION_S
from maidenflight.reporting import identified, text
from maidenflight.reporting.identified import SIMULATED, Kinds
from maidenflight.reporting.run import Run
from maidenflight.reporting.sections import parameters
from maidenflight.simulator.tasks.failures import REACHED

NAMES = ("thrust_to_weight", "motor_time_constant", "latency")
"""The paper's three parameters."""


def kind(run: Run) -> str:
    """Returns the badge: `simulated`, `real` or both, with the flights it holds for; or nothing."""
    test_kinds, drawn_from = _kinds_of_tests(run), _drawn_from(run)
    if test_kinds == {True} and drawn_from - {True}:
        return f"{_what(run)} simulated"
    if test_kinds == {False} and None in drawn_from and True not in drawn_from:
        return f"{_what(run)} real"
    if not test_kinds and None in drawn_from:
        return "simulated in part" if True in drawn_from else ""
    return " and ".join(
        word
        for each, word in ((False, "real"), (True, "simulated"))
        if each in test_kinds | drawn_from
    )


def _kinds_of_tests(run: Run) -> Kinds:
    """Kinds of the flights of the page."""
    kinds = {bool(flight.simulated) for flight in (*run.recorded, *run.flights)}
    simulated = run.reality is not None or run.prediction is not None
    return frozenset(kinds | ({True} if simulated else set()))


def _drawn_from(run: Run) -> Kinds:
    """Kinds of the flights that parameters and errors come from."""
    validated = run.validation is not None or run.windows is not None
    return (run.kinds if run.estimates else frozenset()) | (
        run.predicted if validated else frozenset()
    )


def _what(run: Run) -> str:
    if run.table is not None:
        return "test flights"
    return "recorded flights" if run.recorded else "predicted flights"


def drones(run: Run) -> str:
    """Returns the virtual drones that flew, by name."""
    flights = (*run.recorded, *run.flights)
    return _virtual(flight.simulated for flight in flights if flight.simulated)


def _virtual(names: Iterable[str]) -> str:
    virtual_names = sorted(set(names))
    if not virtual_names:
        return ""
    return f"virtual drone{'s' if len(virtual_names) > 1 else ''} {listed(virtual_names)}"


def title(run: Run) -> str:
    """Returns the page's title, plain text."""
    if run.estimates and not (run.kinds == SIMULATED and drones(run)):
        description = identified.flights(run.drone, run.kinds, ", ")
        return f"A drone identified from {description}" if description else "An identified drone"
    if drones(run) or kind(run) == "real":
        return f"Flights of {drones(run) or 'a real drone'}"
    entries = {
        "Test flights": run.table is not None,
        "Policies in training": run.training is not None or run.policies > 0,
        "Predicted flight times": run.prediction is not None,
        "How well a drone is predicted": run.validation is not None,
        "Results of a study": run.study is not None,
    }
    return next((words for words, there in entries.items() if there), "Report of a run")


def summarize(run: Run) -> str:
    """Returns what this run is, in two or three sentences."""
    trained = []
    if run.policies:
        trained.append(f"{text.plural(run.policies, 'policy')} trained in simulation")
    if run.study is not None:
        entries = text.plural(run.study["task"].n_unique(), "entry")
        trained.append(f"a study of {entries} and {text.plural(run.study.height, 'row')}")
    lines = [*_predicted(run), *_tested(run)]
    differs = _kinds_of_tests(run) == {True} and bool(_drawn_from(run) - {True}) and bool(lines)
    sentences = [
        f"{listed(facts)}."
        for facts in (_of_the_drone(run), [*trained, *([] if differs else lines)])
        if facts
    ]
    if differs:
        sentences.append(f"These flights are simulated: {listed(lines)}.")
    elif _kinds_of_tests(run) | _drawn_from(run) == {True}:
        sentences.append("Everything here is simulated: no real drone flew.")
    return " ".join(sentences) or "The parameters of a drone."


def _of_the_drone(run: Run) -> list[str]:
    facts = []
    if run.recorded:
        seconds = sum(flight.duration for flight in run.recorded)
        few = f"The first {len(run.recorded)} of " if run.logs > len(run.recorded) else ""
        facts.append(
            f"{few}{text.plural(max(run.logs, len(run.recorded)), 'flight')} ({seconds:.0f} s) "
            f"recorded {_on(run.recorded)}"
        )
    if run.estimates:
        values = [_value(run, name) for name in NAMES if name in run.estimates]
        among = (
            f", {'among them ' if len(values) < len(run.estimates) else ''}{listed(values)}"
            if values
            else ""
        )
        facts.append(
            f"{text.plural(len(run.estimates), 'parameter')} identified from "
            f"{identified.flights(run.drone, run.kinds, ' (', ')') or 'flight logs'}{among}"
        )
    return facts


def _value(run: Run, name: str) -> str:
    return f"{text.label(name)} {parameters.estimate(run, name)[0]} {text.unit(name)}".rstrip()


class Judgement(NamedTuple):
    """What a prediction says of a policy."""

    is_good: bool
    sentence: str


def judgements(run: Run) -> list[Judgement]:
    """Returns what the record of a prediction says of its policies, those that may fly first."""
    lists = [record.get("verdicts") for record in run.records.values()]
    all_of_them = [
        Judgement(bool(entry.get("good")), str(entry.get("sentence", "")))
        for some in lists
        for entry in (some if isinstance(some, list) else [])
        if isinstance(entry, dict)
    ]
    return sorted(all_of_them, key=lambda judgement: not judgement.is_good)


def _predicted(run: Run) -> list[str]:
    if run.prediction is None:
        return []
    count = text.plural(run.prediction["policy"].n_unique(), "policy")
    flights = text.plural(run.prediction.height, "flight")
    return [f"{flights} of {count} predicted on an identified drone"]


def _tested(run: Run) -> list[str]:
    if run.table is None:
        return []
    remark = f"on {listed(run.table['reality'].unique(maintain_order=True))}"
    if run.flights:
        remark = _on(run.flights)
        remark = "on the same drone" if run.recorded and remark == _on(run.recorded) else remark
    return [f"{text.plural(run.table.height, 'test flight')} flown {remark}"]


def _on(flights: Iterable[Any]) -> str:
    names = {flight.simulated for flight in flights}
    virtual = _virtual(name for name in names if name)
    real = ["a real drone"] if "" in names else []
    return "on " + listed([*real, *([f"{virtual} (simulated)"] if virtual else [])])


def describe_realities(run: Run) -> str:
    """Returns where test flights flew, in a few words."""
    virtual = _virtual(flight.simulated for flight in run.flights if flight.simulated)
    return f"on {virtual}" if virtual else ""


def listed(entries: Iterable[str]) -> str:
    """Joins words: `one`, `one and another`, `one, another and a third`; empty of none."""
    *most, last = [*entries] or [""]
    return f"{', '.join(most)} and {last}" if most else last


class KeyFigure(NamedTuple):
    """A number, its unit, what it is, and a note."""

    value: str
    unit: str
    label: str
    note: str


def key_figures(run: Run, decimals: Mapping[str, int] | None = None) -> list[KeyFigure]:
    """Returns the few numbers that matter; of parameters with so many decimals, by name."""
    return [
        *_of_parameters(run, decimals or {}),
        *_of_training(run),
        *_of_predictions(run),
        *_of_flights(run),
    ]


def _of_parameters(run: Run, decimals: Mapping[str, int]) -> list[KeyFigure]:
    figures = []
    for name in NAMES:
        label = Markup("{} {}").format(text.label(name), text.symbol(name))
        if name in run.estimates:
            value, low, high = parameters.estimate(run, name, decimals.get(name))
            note = f"95 % interval {low} to {high}"
            figures.append(KeyFigure(value, text.unit(name), label, note))
        elif name in run.unidentified:
            low, high = parameters.plausible(run, name)
            note = f"plausible: {low} to {high} {text.unit(name)}".rstrip()
            figures.append(KeyFigure("not identified", "", label, note))
    return figures


def _of_training(run: Run) -> list[KeyFigure]:
    """Summarizes training where there is no flight yet."""
    if run.training is None or run.table is not None:
        return []
    last = run.training.filter(polars.col("steps") == polars.col("steps").max())
    best = last.sort("episode_return", descending=True).row(0, named=True)
    of = f"of {text.plural(last.height, 'policy')}" if last.height > 1 else "at the end of training"
    survival, error = f"{100 * best['survival']:.1f}", _centimetres(best["position_error"])
    remark = "in simulation, with randomization"
    return [
        KeyFigure(text.number(best["episode_return"], 3), "", "return of the best policy", of),
        KeyFigure(survival, "%", "episodes that it survives", remark),
        KeyFigure(error, "cm", "its mean position error", "mean over an episode"),
    ]


def _of_flights(run: Run) -> list[KeyFigure]:
    if run.table is None:
        return []
    reached = run.table.filter(end_reason=REACHED)
    limit = reached["duration"].to_numpy().max() if reached.height else MAX_DURATION_S
    simulated = bool(run.flights) and all(flight.simulated for flight in run.flights)
    text_start = f"{'simulated test' if simulated else 'test'} flights reached {limit:g} s"
    count, longest = f"of {run.table.height}", f"longest allowed {limit:g} s"
    median = f"{np.median(run.table['duration'].to_numpy()):.1f}"
    # How far a flight is that a guard soon ends says nothing.
    error = _mean(reached["position_error"].to_numpy())
    known = "estimated_error" in reached.columns
    estimated = _mean(reached["estimated_error"].to_numpy()) if known else error
    by_drone = f"{_centimetres(estimated)} cm as the drone estimates it" if known else "true"
    return [
        KeyFigure(f"{reached.height}", count, text_start, describe_realities(run) or "zero-shot"),
        KeyFigure(median, "s", "their median flight time", longest),
        *(
            [KeyFigure(_centimetres(error), "cm", "mean position error of those", by_drone)]
            if np.isfinite(error)
            else []
        ),
    ]


def _of_predictions(run: Run) -> list[KeyFigure]:
    if run.prediction is None:
        return []
    policies = run.prediction.group_by("policy", maintain_order=True)
    times = policies.agg(polars.col("duration").mean())["duration"].to_numpy()
    reached, count = run.prediction.filter(end_reason=REACHED).height, run.prediction.height
    median, over = f"{np.median(times):.1f}", f"median over {text.plural(len(times), 'policy')}"
    best, share = f"{times.max():.1f}", f"{100 * reached / count:.0f}"
    words = "that of the policy that flies longest"
    return [
        KeyFigure(median, "s", "predicted flight time on the identified drone", over),
        KeyFigure(best, "s", words, "mean over its flights"),
        KeyFigure(share, "%", "predicted flights reach the time limit", f"{reached} of {count}"),
    ]


def _mean(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else float("nan")


def _centimetres(metres: float) -> str:
    return f"{metres * 100:.2f}" if np.isfinite(metres) else text.NOTHING
