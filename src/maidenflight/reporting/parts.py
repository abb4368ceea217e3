"""How the page begins: what kind of run this is, in a title, a sentence and a few big numbers."""

from collections.abc import Iterable
from html import escape
from typing import Any

import numpy as np
import polars

from maidenflight.experiments.transfer import LONGEST
from maidenflight.parameters import QUANTITIES
from maidenflight.reporting import parameter_tables, text
from maidenflight.reporting.flight_figures import REACHED
from maidenflight.reporting.flight_tables import is_matrix
from maidenflight.reporting.run import Run


def kind(run: Run) -> str:
    """`simulated`, `real`, `real and simulated`, or nothing where no flight tells."""
    kinds = {bool(flight.simulated) for flight in (*run.recorded, *run.flights)}
    if run.reality is not None or run.prediction is not None or is_matrix(run):
        kinds.add(True)
    return {(): "", (True,): "simulated", (False,): "real", (False, True): "real and simulated"}[tuple(sorted(kinds))]


def drones(run: Run) -> str:
    """Names of the virtual drones that flew."""
    return ", ".join(sorted({flight.simulated for flight in (*run.recorded, *run.flights) if flight.simulated}))


def title(run: Run) -> str:
    """The page's title."""
    name = drones(run)
    if run.table is not None and is_matrix(run):
        return f"Zero-shot flights of {text.plural(run.table['policy'].n_unique(), 'policy')}"
    if name or kind(run) == "real":
        return f"Flights of virtual drone {name}" if name else "Flights of a real drone"
    known = {
        "Test flights": run.table is not None,
        "An identified drone": bool(run.estimates),
        "Policies in training": run.training is not None or run.policies > 0,
        "Predicted flight times": run.prediction is not None,
        "How well a drone is predicted": run.validation is not None,
    }
    return next((words for words, there in known.items() if there), "Report of a run")


def lead(run: Run) -> str:
    """What this run is, in a sentence or two."""
    facts = []
    if run.recorded:
        seconds = sum(flight.duration for flight in run.recorded)
        few = f"The first {len(run.recorded)} of " if run.logs > len(run.recorded) else ""
        facts.append(f"{few}{text.plural(max(run.logs, len(run.recorded)), 'flight')} ({seconds:.0f} s) recorded {_on(run.recorded)}")
    if run.estimates:
        facts.append(f"{_listed(text.symbol(name) for name in run.estimates)} identified from flight logs")
    if run.policies:
        facts.append(f"{text.plural(run.policies, 'policy')} trained in simulation")
    if run.prediction is not None:
        count = text.plural(run.prediction["policy"].n_unique(), "policy")
        facts.append(f"{text.plural(run.prediction.height, 'flight')} of {count} predicted on an identified drone")
    if run.table is not None:
        facts.append(f"{text.plural(run.table.height, 'test flight')} flown {_where(run, run.table)}")
    sentence = f"{_listed(facts)}." if facts else "The parameters of a drone."
    close = {"simulated": " Everything here is simulated: no real drone has flown."}
    return sentence + close.get(kind(run), "")


def _where(run: Run, table: polars.DataFrame) -> str:
    if run.recorded and run.flights and _on(run.flights) == _on(run.recorded):
        return "on the same drone"
    return _on(run.flights) if run.flights else f"on {_listed(escape(name) for name in table['reality'].unique(maintain_order=True))}"


def _on(flights: Iterable[Any]) -> str:
    names = sorted({flight.simulated for flight in flights})
    return "on " + _listed(f"virtual drone {escape(name)} (simulated)" if name else "a real drone" for name in names)


def _listed(entries: Iterable[str]) -> str:
    entries = list(entries)
    return entries[0] if len(entries) == 1 else f"{', '.join(entries[:-1])} and {entries[-1]}"


def key_figures(run: Run) -> str:
    """The few numbers that matter, big."""
    shown = [*_of_parameters(run), *_of_training(run), *_of_flights(run), *_of_predictions(run)]
    entries = "".join(f"<li><b>{value}</b><span>{label}</span><span class=note>{note}</span></li>" for value, label, note in shown)
    return f'<ul class="figures">{entries}</ul>' if shown else ""


Figure = tuple[str, str, str]
"""A number, what it is, and a note."""


def _of_parameters(run: Run) -> list[Figure]:
    shown = []
    for name in ("thrust_to_weight", "motor_time_constant", "latency"):
        if name in run.estimates:
            value, low, high = parameter_tables.estimate(run, name)
            unit = f" <small>{text.unit(name)}</small>" if text.unit(name) else ""
            shown.append((f"{value}{unit}", f"{text.symbol(name)}, {QUANTITIES[name].meaning}", f"95 % interval {low} to {high}"))
    return shown


def _of_training(run: Run) -> list[Figure]:
    """Where nothing has flown yet, what training ended with."""
    if run.training is None or run.table is not None:
        return []
    last = run.training.filter(polars.col("steps") == polars.col("steps").max())
    best = last.sort("episode_return", descending=True).row(0, named=True)
    of = f"of {text.plural(last.height, 'policy')}" if last.height > 1 else "at the end of training"
    return [
        (text.number(best["episode_return"], 3), "return of the best policy", of),
        (f"{100 * best['survival']:.1f} <small>%</small>", "episodes that it survives", "in simulation, with randomization"),
        (f"{_centimetres(best['position_error'])} <small>cm</small>", "its mean position error", "mean over an episode"),
    ]


def _of_flights(run: Run) -> list[Figure]:
    if run.table is None:
        return []
    reached = run.table.filter(polars.col("end_reason") == REACHED)
    limit = reached["duration"].to_numpy().max() if reached.height else LONGEST
    word = "simulated " if kind(run) == "simulated" else ""
    median, error = np.median(run.table["duration"].to_numpy()), _mean(run.table["position_error"].to_numpy())
    return [
        (f"{reached.height} <small>of {run.table.height}</small>", f"{word}flights reached {limit:g} s", "zero-shot"),
        (f"{median:.1f} <small>s</small>", "median flight time", f"longest allowed {limit:g} s"),
        (f"{_centimetres(error)} <small>cm</small>", "mean position error", "mean over flights"),
    ]


def _of_predictions(run: Run) -> list[Figure]:
    if run.prediction is None:
        return []
    times = run.prediction.group_by("policy", maintain_order=True).agg(polars.col("duration").mean())["duration"].to_numpy()
    reached = run.prediction.filter(polars.col("end_reason") == REACHED).height
    count = run.prediction.height
    return [
        (f"{np.median(times):.1f} <small>s</small>", "predicted flight time", f"median over {text.plural(len(times), 'policy')}"),
        (f"{times.max():.1f} <small>s</small>", "that of the policy that flies longest", "mean over its flights"),
        (f"{100 * reached / count:.0f} <small>%</small>", "predicted flights reach the time limit", f"{reached} of {count}"),
    ]


def _mean(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else float("nan")


def _centimetres(metres: float) -> str:
    return f"{metres * 100:.2f}" if np.isfinite(metres) else text.NOTHING
