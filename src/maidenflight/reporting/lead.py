"""Title, badge and first sentences of the page.

A run is called simulated only where all its flights are known to be.
"""

from collections.abc import Iterable
from typing import Any

import polars

from maidenflight.reporting import identified, text
from maidenflight.reporting.identified import SIMULATED, Kinds
from maidenflight.reporting.run import Run

NAMES = {
    "thrust_to_weight": "thrust-to-weight ratio",
    "motor_time_constant": "motor lag",
    "latency": "latency",
}
"""The paper's three parameters in words."""


def kind(run: Run) -> str:
    """The badge: `simulated`, `real` or both, with the flights it holds for; or nothing."""
    flown, drawn_from = _flown(run), _drawn_from(run)
    if flown == {True} and drawn_from - {True}:
        return f"{_what(run)} simulated"
    if flown == {False} and None in drawn_from and True not in drawn_from:
        return f"{_what(run)} real"
    if not flown and None in drawn_from:
        return "simulated in part" if True in drawn_from else ""
    return " and ".join(
        word for each, word in ((False, "real"), (True, "simulated")) if each in flown | drawn_from
    )


def _flown(run: Run) -> Kinds:
    """Kinds of the flights that are shown."""
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
    """The virtual drones that flew, by name."""
    return _virtual(
        flight.simulated for flight in (*run.recorded, *run.flights) if flight.simulated
    )


def _virtual(names: Iterable[str]) -> str:
    found = sorted(set(names))
    return f"virtual drone{'s' if len(found) > 1 else ''} {listed(found)}" if found else ""


def title(run: Run) -> str:
    """The page's title, plain text."""
    if run.estimates and not (run.kinds == SIMULATED and drones(run)):
        found = identified.flights(run.drone, run.kinds, ", ")
        return f"A drone identified from {found}" if found else "An identified drone"
    if drones(run) or kind(run) == "real":
        return f"Flights of {drones(run) or 'a real drone'}"
    known = {
        "Test flights": run.table is not None,
        "Policies in training": run.training is not None or run.policies > 0,
        "Predicted flight times": run.prediction is not None,
        "How well a drone is predicted": run.validation is not None,
        "Results of a study": run.study is not None,
    }
    return next((words for words, there in known.items() if there), "Report of a run")


def lead(run: Run) -> str:
    """What this run is, in two or three sentences."""
    trained = (
        [f"{text.plural(run.policies, 'policy')} trained in simulation"] if run.policies else []
    )
    if run.study is not None:
        entries = text.plural(run.study["task"].n_unique(), "entry")
        trained = [*trained, f"a study of {entries} and {text.plural(run.study.height, 'row')}"]
    flown = [*_predicted(run), *_tested(run)]
    apart = _flown(run) == {True} and bool(_drawn_from(run) - {True}) and bool(flown)
    sentences = [
        f"{listed(facts)}."
        for facts in (_of_the_drone(run), [*trained, *([] if apart else flown)])
        if facts
    ]
    if apart:
        sentences.append(f"These flights are simulated: {listed(flown)}.")
    elif _flown(run) | _drawn_from(run) == {True}:
        sentences.append("Everything here is simulated: no real drone has flown.")
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
    return (
        f"{NAMES[name]} {text.number(run.estimates[name].value * text.factor(name), 3)} "
        f"{text.unit(name)}"
    ).rstrip()


def _predicted(run: Run) -> list[str]:
    if run.prediction is None:
        return []
    count = text.plural(run.prediction["policy"].n_unique(), "policy")
    return [
        f"{text.plural(run.prediction.height, 'flight')} of {count} predicted on an identified "
        "drone"
    ]


def _tested(run: Run) -> list[str]:
    return (
        []
        if run.table is None
        else [f"{text.plural(run.table.height, 'test flight')} flown {_where(run, run.table)}"]
    )


def _where(run: Run, table: polars.DataFrame) -> str:
    if run.recorded and run.flights and _on(run.flights) == _on(run.recorded):
        return "on the same drone"
    return (
        _on(run.flights)
        if run.flights
        else f"on {listed(name for name in table['reality'].unique(maintain_order=True))}"
    )


def _on(flights: Iterable[Any]) -> str:
    names = {flight.simulated for flight in flights}
    virtual = _virtual(name for name in names if name)
    return "on " + listed(
        [
            *(["a real drone"] if "" in names else []),
            *([f"{virtual} (simulated)"] if virtual else []),
        ]
    )


def flown_on(run: Run) -> str:
    """Where test flights flew, in a few words."""
    virtual = _virtual(flight.simulated for flight in run.flights if flight.simulated)
    return f"on {virtual}" if virtual else ""


def listed(entries: Iterable[str]) -> str:
    """`one`, `one and another`, `one, another and a third`; empty of none."""
    *most, last = [*entries] or [""]
    return f"{', '.join(most)} and {last}" if most else last
