"""The page's tables of parameters: identified, true, the paper's, others'; and all of a drone."""

from html import escape

import numpy as np
import polars

from maidenflight.flights.windows import BLOCK
from maidenflight.parameters import COMPONENTS, QUANTITIES, component
from maidenflight.reporting import identification_tables, literature, tables, text
from maidenflight.reporting.run import Estimate, Run, true_ends
from maidenflight.reporting.tables import Cell

_RANGES = {
    "motor_time_constant": ("speeding up", "slowing down"),
    "latency": ("command", "command + sensors"),
}


def scaled(run: Run, name: str) -> tuple[float, str]:
    """Factor and unit of an identified parameter, with a power of ten where its number would be all
    zeros.
    """
    return text.scale(name, [run.estimates[name].value])


def estimate(run: Run, name: str) -> tuple[str, str, str]:
    """Value and interval with as many decimals as the interval justifies."""
    found, (scale, _) = run.estimates[name], scaled(run, name)
    low, high = (side * scale for side in found.interval)
    digits = text.places(high - low)
    return _written(found.value * scale, digits), _written(low, digits), _written(high, digits)


def _written(value: float, digits: int) -> str:
    return f"{value:.{digits}f}".replace("-", "\N{MINUS SIGN}")


def _truth(run: Run, name: str, scale: float) -> Cell:
    """The truth with its meaning where it is a range."""
    ends = true_ends(run, name)
    if name not in _RANGES or np.isclose(*ends):
        return Cell(text.number(ends[0] * scale), ends[0])
    parts = zip(ends, _RANGES[name], strict=True)
    return Cell(
        " ..<br>".join(
            f"{end * text.factor(name):.1f} <small>({word})</small>" for end, word in parts
        ),
        ends[0],
    )


def _head(name: str, unit: str) -> Cell:
    told = f" [{unit}]" if unit else ""
    return Cell(f"{text.symbol(name)}{told}<small> {escape(_meaning(name))}</small>", name)


def _meaning(name: str) -> str:
    """What a parameter is; of a component of a vector, which."""
    told = text.quantity(name).meaning
    return (
        told
        if COMPONENTS.get(name, (name, None))[1] is None
        else told.replace(": x, y, z", f", {name[-1]}").replace(" x, y, z", f" {name[-1]}")
    )


def estimates(run: Run) -> str:
    """The identified parameters beside the truth, the paper and others."""
    if not run.estimates:
        return ""
    spread = any(found.spread is not None for found in run.estimates.values())
    heads = [("parameter", "Parameter"), ("value", "Identified"), ("interval", "95 % interval")]
    heads += [("spread", "Between stretches")] if spread else []
    heads += [("truth", "Truth")] if run.reality is not None else []
    heads += [("paper", "Paper"), ("others", "Others")]
    rows, file = [], []
    for name, found in run.estimates.items():
        value, low, high = estimate(run, name)
        scale, unit = scaled(run, name)
        paper, others = (
            literature.of_the_paper(name),
            [each.value for each in literature.published(name)],
        )
        cells = [_head(name, unit), Cell(f"<b>{value}</b>", found.value)]
        cells.append(Cell(f"{low} .. {high}", found.interval[0]))
        cells += [_spread(found, scale)] if spread else []
        cells += [_truth(run, name, scale)] if run.reality is not None else []
        cells += [Cell(text.number(paper * scale), paper), _range(others, scale)]
        rows.append(("", cells))
        ends = true_ends(run, name) if run.reality is not None else (None, None)
        file.append(
            {
                "parameter": name,
                "unit": text.quantity(name).unit,
                "value": found.value,
                "low": found.interval[0],
                "high": found.interval[1],
            }
            | ({"spread": found.spread} if spread else {})
            | {"truth": ends[0], "truth_to": ends[1], "paper": paper}
            | {"others_from": min(others, default=None), "others_to": max(others, default=None)}
        )
    between = (
        f" Between stretches: how far the parameter moves from one stretch of {BLOCK:g} s to the "
        "next (standard deviation), by itself or"
        " for what the model lacks, beyond chance; a single flight may be as far off."
        if spread
        else ""
    )
    return (
        tables.sortable("estimates", heads, rows, polars.DataFrame(file, infer_schema_length=None))
        + "<p class=note>The interval comes from how stretches of flight differ: it shows how "
        "much the result depends on the flights"
        f" recorded, not how well the model fits.{between}{identification_tables.missed(run)}"
        f" Paper: {literature.PAPER}, a real Crazyflie 2.1, another drone than this.</p>"
    )


def _spread(found: Estimate, scale: float) -> Cell:
    if found.spread is None:
        return Cell(text.NOTHING, float("nan"))
    return Cell(
        f"{found.spread * scale:.{text.places(found.spread * scale) if found.spread else 0}f}",
        found.spread,
    )


def _range(values: list[float], scale: float) -> Cell:
    if not values:
        return Cell(text.NOTHING, float("nan"))
    low, high = text.number(min(values) * scale, 3), text.number(max(values) * scale, 3)
    return Cell(
        low if low == high else f"{low} .. {high} <small>({len(values)})</small>", min(values)
    )


def others(run: Run) -> str:
    """What others give for the identified parameters, and who, folded away."""
    known = [each for name in run.estimates for each in literature.published(name)]
    if not known:
        return ""
    rows = []
    for each in known:
        scale, unit = scaled(run, each.parameter)
        rows.append(
            (
                "",
                [
                    _head(each.parameter, unit),
                    Cell(text.number(each.value * scale, 3), each.value),
                    tables.words(each.source),
                ],
            )
        )
    file = polars.DataFrame([each._asdict() for each in known])
    table = tables.sortable(
        "literature",
        [("parameter", "Parameter"), ("value", "Value"), ("source", "Source")],
        rows,
        file,
    )
    count = len({each.source for each in known})
    return (
        f"<details><summary>What {count} other sources give for a "
        f"Crazyflie</summary>{table}</details>"
    )


def constants(run: Run) -> str:
    """Every parameter that the simulation was trained with, folded away."""
    known = [
        (head, drone)
        for head, drone in (("Identified", run.drone), ("Truth", run.reality))
        if drone is not None
    ]
    if not known:
        return ""
    rows, file = [], []
    for name, (field, _) in COMPONENTS.items():
        values = [float(component(drone, name)) for _, drone in known]
        factor = text.factor(name)
        rows.append(
            (
                "",
                [
                    _head(name, text.unit(name)),
                    *(Cell(text.number(value * factor), value) for value in values),
                ],
            )
        )
        file.append(
            {"parameter": name, "unit": QUANTITIES[field].unit}
            | {head.lower(): value for (head, _), value in zip(known, values, strict=True)}
        )
    heads = [("parameter", "Parameter"), *((head.lower(), head) for head, _ in known)]
    table = tables.sortable("all", heads, rows, polars.DataFrame(file))
    return (
        f"<details><summary>All {len(QUANTITIES)} parameters of the "
        f"drone</summary>{table}</details>"
    )
