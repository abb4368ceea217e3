"""The page's parts as HTML, one function a part; a part of which nothing is known is an empty string."""

import json
from collections.abc import Iterable, Mapping
from html import escape
from typing import Any
from urllib.parse import quote

import numpy as np
import polars

from maidenflight.experiments.transfer import LONGEST
from maidenflight.parameters import COMPONENTS, QUANTITIES, Parameters, component, crazyflie
from maidenflight.reporting import text
from maidenflight.reporting.run import Run, viewable

_COLUMNS = {
    "flight": "Flight",
    "policy": "Policy",
    "reality": "Drone",
    "trial": "Trial",
    "duration": "Duration [s]",
    "end_reason": "Ended by",
    "position_error": "Mean position error [cm]",
}
_RANGES = {
    "motor_time_constant": ("speeding up", "slowing down"),
    "latency": ("command", "command + sensors"),
}


def kind(run: Run) -> str:
    """`simulated`, `real`, `real and simulated`, or nothing where no flight tells."""
    kinds = {bool(flight.simulated) for flight in (*run.recorded, *run.flights)}
    if run.reality is not None:
        kinds.add(True)
    return {(): "", (True,): "simulated", (False,): "real", (False, True): "real and simulated"}[tuple(sorted(kinds))]


def drones(run: Run) -> str:
    """Names of the virtual drones that flew."""
    return ", ".join(sorted({flight.simulated for flight in (*run.recorded, *run.flights) if flight.simulated}))


def title(run: Run) -> str:
    """The page's title."""
    name = drones(run)
    return f"Flights of virtual drone {name}" if name else "Flights of a real drone" if kind(run) == "real" else "Report of a run"


def lead(run: Run) -> str:
    """One sentence of what this run is."""
    facts = []
    if run.recorded:
        seconds = sum(flight.duration for flight in run.recorded)
        facts.append(f"{text.plural(len(run.recorded), 'flight')} ({seconds:.0f} s) recorded {_on(run.recorded)}")
    if run.estimates:
        facts.append(f"{_listed(text.symbol(name) for name in run.estimates)} identified from flight logs")
    if run.policies:
        facts.append(f"{text.plural(run.policies, 'policy')} trained in simulation")
    if run.table is not None:
        same = run.recorded and run.flights and _on(run.flights) == _on(run.recorded)
        where = (
            "on the same drone"
            if same
            else _on(run.flights)
            if run.flights
            else f"on {escape(', '.join(run.table['reality'].unique(maintain_order=True)))}"
        )
        facts.append(f"{text.plural(run.table.height, 'test flight')} flown {where}")
    sentence = f"{_listed(facts)}." if facts else "The parameters of a drone."
    close = {"simulated": " Everything here is simulated: no real drone has flown."}
    return sentence + close.get(kind(run), "")


def _on(flights: Iterable[Any]) -> str:
    names = sorted({flight.simulated for flight in flights})
    return "on " + _listed(f"virtual drone {escape(name)} (simulated)" if name else "a real drone" for name in names)


def _listed(entries: Iterable[str]) -> str:
    entries = list(entries)
    return entries[0] if len(entries) == 1 else f"{', '.join(entries[:-1])} and {entries[-1]}"


def key_figures(run: Run) -> str:
    """The few numbers that matter, big."""
    shown = []
    for name in ("thrust_to_weight", "motor_time_constant", "latency"):
        if name in run.estimates:
            value, low, high = _estimate(run, name)
            unit = f" <small>{text.unit(name)}</small>" if text.unit(name) else ""
            shown.append((f"{value}{unit}", f"{text.symbol(name)}, {QUANTITIES[name].meaning}", f"95 % interval {low} to {high}"))
    if run.table is not None:
        reached = run.table.filter(polars.col("end_reason") == "time limit")
        limit = reached["duration"].to_numpy().max() if reached.height else LONGEST
        word = "simulated " if kind(run) == "simulated" else ""
        shown.append((f"{reached.height} <small>of {run.table.height}</small>", f"{word}flights reached {limit:g} s", "zero-shot"))
        median, error = np.median(run.table["duration"].to_numpy()), _mean(run.table["position_error"].to_numpy())
        shown.append((f"{median:.1f} <small>s</small>", "median flight time", f"longest allowed {limit:g} s"))
        shown.append((f"{_centimetres(error)} <small>cm</small>", "mean position error", "mean over flights"))
    entries = "".join(f"<li><b>{value}</b><span>{label}</span><span class=note>{note}</span></li>" for value, label, note in shown)
    return f'<ul class="figures">{entries}</ul>' if shown else ""


def _scale(run: Run, name: str) -> tuple[float, str]:
    """Factor and unit of an identified parameter, with a power of ten where its number would be all zeros."""
    return text.scale(name, [run.estimates[name].value])


def _estimate(run: Run, name: str) -> tuple[str, str, str]:
    """Value and interval with as many decimals as the interval justifies."""
    found, (scale, _) = run.estimates[name], _scale(run, name)
    low, high = (side * scale for side in found.interval)
    digits = text.places(high - low)
    return f"{found.value * scale:.{digits}f}", f"{low:.{digits}f}", f"{high:.{digits}f}"


def _shown(drone: Parameters, name: str, scale: float | None = None) -> str:
    given = component(drone, name) if name in COMPONENTS else getattr(drone, name)
    values = np.atleast_1d(given) * (text.factor(name) if scale is None else scale)
    return ", ".join(text.number(value) for value in values)


def _truth(reality: Parameters, name: str, scale: float) -> str:
    """The truth with its meaning where the simulation has two values for what the model has one for."""
    ends = {
        "motor_time_constant": (reality.motor_time_constant, reality.motor_time_constant * reality.motor_slowdown),
        "latency": (reality.latency, reality.latency + reality.estimator_delay + reality.gyro_lag),
    }
    if name not in ends or np.isclose(*ends[name]):
        return _shown(reality, name, scale)
    parts = zip(ends[name], _RANGES[name], strict=True)
    return " .. ".join(f"{float(end) * text.factor(name):.1f} <small>({word})</small>" for end, word in parts)


def _row(name: str, cells: Iterable[str], unit: str | None = None) -> str:
    told = text.unit(name) if unit is None else unit
    unit = f" [{told}]" if told else ""
    head = f"<th scope=row>{text.symbol(name)}{unit}<small> {escape(text.quantity(name).meaning)}</small></th>"
    return f"<tr>{head}{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"


def _table(heads: Iterable[str], rows: Iterable[str], name: str) -> str:
    head = "".join(f"<th scope=col>{entry}</th>" for entry in heads)
    return f'<div class=scroll><table class="{name}"><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>'


def estimates(run: Run) -> str:
    """The identified parameters beside the truth and the paper."""
    if not run.estimates:
        return ""
    heads = ["Parameter", "Identified", "95 % interval", *(["Truth"] if run.reality is not None else []), "Paper"]
    rows, paper = [], crazyflie()
    for name in run.estimates:
        value, low, high = _estimate(run, name)
        scale, unit = _scale(run, name)
        truth = [_truth(run.reality, name, scale)] if run.reality is not None else []
        rows.append(_row(name, [f"<b>{value}</b>", f"{low} .. {high}", *truth, _shown(paper, name, scale)], unit))
    told = (
        " The truth may lie outside it where the virtual drone has effects that the model lacks, such as a sagging battery, drag or"
        " motors that slow down more slowly than they speed up."
        if run.reality is not None
        else ""
    )
    return (
        _table(heads, rows, "estimates")
        + "<p class=note>The interval comes from how stretches of flight differ: it shows how much the result depends on the flights"
        f" recorded, not how well the model fits.{told} Paper: Gronauer et al. 2022, a real Crazyflie 2.1, another drone than this.</p>"
    )


def constants(run: Run) -> str:
    """Every parameter that the simulation was trained with, folded away."""
    if run.drone is None and run.reality is None:
        return ""
    known = [(head, drone) for head, drone in (("Used in training", run.drone), ("Truth", run.reality)) if drone is not None]
    rows = [_row(name, [_shown(drone, name) for _, drone in known]) for name in QUANTITIES]
    table = _table(["Parameter", *(head for head, _ in known)], rows, "all")
    return f"<details><summary>All {len(rows)} parameters</summary>{table}</details>"


def flights_table(run: Run) -> str:
    """The table of test flights, for sorting and for choosing what the viewer shows."""
    if run.table is None:
        return ""
    heads = [f'<button type=button data-column="{name}">{label}</button>' for name, label in _COLUMNS.items()]
    rows, viewed = [], set(viewable(run))
    for number, row in enumerate(run.table.iter_rows(named=True)):
        shown = dict(row) | {"duration": f"{row['duration']:.2f}", "position_error": _centimetres(row["position_error"])}
        if number in viewed:
            shown["flight"] = _Markup(f'<button type=button class=choose aria-label="Show flight {row["flight"]}">{row["flight"]}</button>')
        cells = "".join(
            f'<td data-value="{_plain(row[name])}">{cell if isinstance(cell := shown[name], _Markup) else escape(str(cell))}</td>'
            for name in _COLUMNS
        )
        rows.append(f'<tr data-flight="{number}">{cells}</tr>')
    content = quote(run.table.select(list(_COLUMNS)).write_csv())
    return (
        _table(heads, rows, "flights")
        + f'<p><a class=button download="flights.csv" href="data:text/csv;charset=utf-8,{content}">Download as CSV</a></p>'
    )


def _plain(value: Any) -> str:
    """What a column is sorted by; empty for a number that is none."""
    return "" if isinstance(value, float) and not np.isfinite(value) else escape(str(value))


def _mean(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else float("nan")


def _centimetres(metres: float) -> str:
    return f"{metres * 100:.2f}" if np.isfinite(metres) else text.NOTHING


class _Markup(str):
    """Text that is HTML already."""


def seconds(run: Run) -> str:
    """How long each stage took, as bars."""
    if not run.seconds:
        return ""
    longest, total = max(run.seconds.values()) or 1.0, sum(run.seconds.values())
    rows = [
        f"<tr><th scope=row>{escape(stage)}</th><td>{time:.1f} s</td>"
        f'<td class=bar><i style="width:{100 * time / longest:.1f}%"></i></td></tr>'
        for stage, time in run.seconds.items()
    ]
    rows.append(f"<tr><th scope=row>all stages</th><td>{total:.1f} s</td><td></td></tr>")
    return f'<h3>Time of each stage</h3><table class="stages"><tbody>{"".join(rows)}</tbody></table>'


def records(run: Run) -> str:
    """How each file was made; files made alike share a table."""
    alike: dict[str, list[str]] = {}
    for name, record in run.records.items():
        alike.setdefault(json.dumps(record, sort_keys=True, default=str), []).append(name)
    parts = []
    for record, names in alike.items():
        rows = "".join(f"<tr><th scope=row>{escape(key)}</th><td>{value}</td></tr>" for key, value in _flat(json.loads(record)))
        parts.append(f"<h3>{escape(_files(names))}</h3><div class=scroll><table class=record><tbody>{rows}</tbody></table></div>")
    return "".join(parts)


def _files(names: list[str]) -> str:
    """Names of files, those of one folder together."""
    folders: dict[str, list[str]] = {}
    for name in names:
        folders.setdefault(name.rpartition("/")[0], []).append(name)
    return ", ".join(
        ", ".join(held) if not folder or len(held) == 1 else f"{folder}/ ({len(held)} files)" for folder, held in folders.items()
    )


def _flat(record: Mapping[str, Any], before: str = "") -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    for key in sorted(record, key=lambda key: ({"version": 0, "seed": 1, "inputs": 2}.get(key, 3), key)):
        value = record[key]
        if isinstance(value, dict):
            rows += _flat(value, f"{before}{key}.")
        elif isinstance(value, list) and any(isinstance(entry, str) for entry in value):
            rows.append((before + key, "<br>".join(escape(str(entry)) for entry in value)))
        else:
            rows.append((before + key, escape(json.dumps(value) if isinstance(value, list) else str(value))))
    return rows
