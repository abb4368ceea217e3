"""The page's tables of parameters: identified, true, the paper's, others'; and all of a drone."""

import numpy as np
import polars
from markupsafe import Markup

from maidenflight.identification.drone_file import Estimate
from maidenflight.identification.outcome.bounds import bound_reached
from maidenflight.parameters import COMPONENTS, QUANTITIES, component
from maidenflight.reporting import literature, tables, text
from maidenflight.reporting.run import Run, true_ends
from maidenflight.reporting.tables import Cell

_RANGES = {
    "motor_time_constant": ("speeding up", "slowing down"),
    "latency": ("command", "command + sensors"),
}


def scaled(run: Run, name: str) -> tuple[float, str]:
    """Factor and unit of an identified parameter, with a power of ten for one that is small."""
    return text.scale(name, [run.estimates[name].value])


def estimate(run: Run, name: str) -> tuple[str, str, str]:
    """Value and interval with as many decimals as the interval justifies."""
    found, (scale, _) = run.estimates[name], scaled(run, name)
    low, high = (side * scale for side in found.interval)
    digits = text.places(high - low)
    return _written(found.value * scale, digits), _written(low, digits), _written(high, digits)


def untold(run: Run) -> list[str]:
    """What the flights could not tell, each with its plausible range."""
    found = []
    for name, ends in ({} if run.drone is None else run.drone.unidentified).items():
        scale, unit = text.scale(name, ends)
        low, high = (text.number(end * scale) for end in ends)
        found.append(f"{name} {low} .. {high} {unit}".strip())
    return found


def _written(value: float, digits: int) -> str:
    return f"{value:.{digits}f}".replace("-", "\N{MINUS SIGN}")


def _truth(run: Run, name: str, scale: float) -> Cell:
    """The truth, with what its ends are where it is a range."""
    ends = true_ends(run, name)
    if name not in _RANGES or np.isclose(*ends):
        return Cell(text.number(ends[0] * scale), ends[0])
    parts = [
        Markup("{} <small>({})</small>").format(f"{end * text.factor(name):.1f}", word)
        for end, word in zip(ends, _RANGES[name], strict=True)
    ]
    return Cell(Markup(" ..<br>").join(parts), ends[0])


def _head(name: str, unit: str) -> Cell:
    shown = Markup("{}{}<small> {}</small>")
    return Cell(shown.format(text.symbol(name), f" [{unit}]" if unit else "", _meaning(name)), name)


def _meaning(name: str) -> str:
    """What a parameter is; of a component of a vector, which."""
    meaning = text.quantity(name).meaning
    if COMPONENTS.get(name, (name, None))[1] is None:
        return meaning
    return meaning.replace(": x, y, z", f", {name[-1]}").replace(" x, y, z", f" {name[-1]}")


def estimates(run: Run) -> Markup | str:
    """The identified parameters beside the truth, the paper and others."""
    if not run.estimates:
        return ""
    heads: list[tuple[str, str]] = [("parameter", "Parameter"), ("value", "Identified")]
    heads += [("interval", "95 % interval")]
    heads += [("between_sd", "Between flights")]
    heads += [("truth", "Truth")] if run.reality is not None else []
    heads += [("paper", "Paper"), ("others", "Others")]
    rows = [_row(run, name) for name in run.estimates]
    file = [_in_si(run, name) for name in run.estimates]
    return tables.sortable(
        "estimates", heads, rows, polars.DataFrame(file, infer_schema_length=None)
    )


def _row(run: Run, name: str) -> list[Cell]:
    found, (scale, unit) = run.estimates[name], scaled(run, name)
    value, low, high = estimate(run, name)
    paper = literature.of_the_paper(name)
    cells = [_head(name, unit), Cell(Markup("<b>{}</b>").format(value), found.value)]
    ends: Markup | str = f"{low} .. {high}"
    if bound_reached(name, found) is not None:
        ends = Markup("{} <small>too narrow: at its search bound</small>").format(ends)
    cells.append(Cell(ends, found.interval[0]))
    cells.append(_between_flights(found, scale))
    cells += [_truth(run, name, scale)] if run.reality is not None else []
    cells.append(Cell(text.number(paper * scale), paper))
    return [*cells, _range([each.value for each in literature.published(name)], scale)]


def _in_si(run: Run, name: str) -> dict[str, str | float | None]:
    """A row of the table's file."""
    found, others = run.estimates[name], [each.value for each in literature.published(name)]
    ends = true_ends(run, name) if run.reality is not None else (None, None)
    low, high = found.interval
    row: dict[str, str | float | None] = {"parameter": name, "unit": text.quantity(name).unit}
    row |= {"value": found.value, "low": low, "high": high}
    row |= {"between_sd": found.between_sd}
    row |= {"truth": ends[0], "truth_to": ends[1], "paper": literature.of_the_paper(name)}
    row |= {"others_from": min(others, default=None), "others_to": max(others, default=None)}
    return row


def _between_flights(found: Estimate, scale: float) -> Cell:
    deviation = found.between_sd * scale
    shown = f"{deviation:.{text.places(deviation) if deviation else 0}f}"
    return Cell(shown, found.between_sd)


def _range(values: list[float], scale: float) -> Cell:
    if not values:
        return Cell(text.NOTHING, float("nan"))
    low, high = text.number(min(values) * scale, 3), text.number(max(values) * scale, 3)
    shown = Markup("{} .. {} <small>({})</small>").format(low, high, len(values))
    return Cell(low if low == high else shown, min(values))


def others(run: Run) -> Markup | str:
    """What others give for the identified parameters, and who."""
    known = [each for name in run.estimates for each in literature.published(name)]
    if not known:
        return ""
    rows = []
    for each in known:
        scale, unit = scaled(run, each.parameter)
        value = Cell(text.number(each.value * scale, 3), each.value)
        rows.append([_head(each.parameter, unit), value, tables.plain(each.source)])
    heads = [("parameter", "Parameter"), ("value", "Value"), ("source", "Source")]
    return tables.sortable(
        "literature", heads, rows, polars.DataFrame([each._asdict() for each in known])
    )


def sources(run: Run) -> int:
    """How many others give any of the identified parameters."""
    return len({each.source for name in run.estimates for each in literature.published(name)})


def constants(run: Run) -> Markup | str:
    """Every parameter of the identified drone and of the virtual one."""
    drones = {
        "Identified": None if run.drone is None else run.drone.parameters,
        "Truth": run.reality,
    }
    known = {head: drone for head, drone in drones.items() if drone is not None}
    if not known:
        return ""
    rows, file = [], []
    for name, (field, _) in COMPONENTS.items():
        values = [float(component(drone, name)) for drone in known.values()]
        factor = text.factor(name)
        shown = (Cell(text.number(value * factor), value) for value in values)
        rows.append([_head(name, text.unit(name)), *shown])
        file.append(
            {"parameter": name, "unit": QUANTITIES[field].unit}
            | dict(zip(map(str.lower, known), values, strict=True))
        )
    heads = [("parameter", "Parameter"), *((head.lower(), head) for head in known)]
    return tables.sortable("all", heads, rows, polars.DataFrame(file))
