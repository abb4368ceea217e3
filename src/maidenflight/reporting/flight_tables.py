"""The page's tables of flights: one row a test flight, a cell of a matrix, a policy whose flights
are predicted.
"""

from html import escape

import polars

from maidenflight.experiments import flight_times, matrix
from maidenflight.identification.prediction import NOTHING_CHANGES
from maidenflight.reporting import tables
from maidenflight.reporting.run import Run, viewable
from maidenflight.reporting.tables import Cell

NAMES = {"pwm": "PWM", "attitude_rate": "Attitude rate", "attitude": "Attitude"}
"""Control structures as people call them."""
_COLUMNS = {
    "flight": "Flight",
    "policy": "Policy",
    "reality": "Drone",
    "trial": "Trial",
    "duration": "Duration [s]",
    "end_reason": "Ended by",
    "position_error": "Mean position error [cm]",
}


def control(name: str) -> str:
    """A control structure's name, or what stands for it."""
    return NAMES.get(name, name)


def flights(run: Run) -> str:
    """The test flights, for sorting and for choosing what the viewer shows."""
    if run.table is None:
        return ""
    viewed, rows = set(viewable(run)), []
    for place, row in enumerate(run.table.iter_rows(named=True)):
        number = str(row["flight"])
        if place in viewed:
            number = (
                '<button type=button class=choose aria-label="Show flight '
                f'{row["flight"]}">{row["flight"]}</button>'
            )
        cells = [
            Cell(number, row["flight"]),
            tables.words(row["policy"]),
            tables.words(row["reality"]),
            tables.words(str(row["trial"])),
        ]
        cells += [
            tables.number(row["duration"], 2),
            tables.words(row["end_reason"]),
            tables.number(row["position_error"], 2, 100.0),
        ]
        rows.append((f'data-flight="{place}"', cells))
    return tables.sortable(
        "flights", list(_COLUMNS.items()), rows, run.table.select(list(_COLUMNS))
    )


def recorded(run: Run) -> str:
    """The recorded flights, for choosing what the viewer shows."""
    viewed, rows, file = set(viewable(run)), [], []
    for place, flight in enumerate(run.recorded):
        name = escape(flight.name)
        shown = (
            f'<button type=button class=choose aria-label="Show {name}">{name}</button>'
            if place in viewed
            else name
        )
        where = flight.simulated or "a real drone"
        cells = [
            Cell(shown, flight.name),
            tables.words(where),
            tables.number(flight.duration, 2),
            Cell(str(len(flight)), len(flight)),
        ]
        rows.append((f'data-flight="{place}"', cells))
        file.append(
            {
                "flight": flight.name,
                "drone": where,
                "duration": flight.duration,
                "rows": len(flight),
            }
        )
    heads = [
        ("flight", "Flight"),
        ("drone", "Drone"),
        ("duration", "Duration [s]"),
        ("rows", "Rows"),
    ]
    return tables.sortable("flights", heads, rows, polars.DataFrame(file))


def is_matrix(run: Run) -> bool:
    """Whether the test flights are those of a matrix."""
    return run.table is not None and {"control", "motor_time_constant", "latency", "number"} <= set(
        run.table.columns
    )


def cells(run: Run) -> str:
    """A row a reality and cell of a matrix."""
    if run.table is None or not is_matrix(run):
        return ""
    found = matrix.by_cell(run.table, float(run.table["duration"].to_numpy().max()))
    heads = [
        ("control", "Control"),
        ("motor_time_constant", "T<sub>m</sub> trained for [ms]"),
        ("latency", "Latency trained for [ms]"),
    ]
    heads += [
        ("reality", "Drone"),
        ("flights", "Flights"),
        ("mean", "Mean time [s]"),
        ("median", "Median time [s]"),
        ("share", "To the end [%]"),
    ]
    rows = []
    for row in found.iter_rows(named=True):
        told = [Cell(escape(control(row["control"])), row["control"])]
        told += [
            Cell(f"{1e3 * row[name]:g}", row[name]) for name in ("motor_time_constant", "latency")
        ]
        told += [tables.words(row["reality"]), Cell(str(row["flights"]), row["flights"])]
        told += [
            tables.number(row["mean"], 2),
            tables.number(row["median"], 2),
            tables.number(row["share"], 0, 100.0),
        ]
        rows.append(("", told))
    return tables.sortable("cells", heads, rows, found)


def predictions(run: Run) -> str:
    """A row a policy whose flights are predicted."""
    if run.prediction is None:
        return ""
    found, rows = flight_times.summary(run.prediction), []
    for row in found.iter_rows(named=True):
        ends = run.prediction.filter(polars.col("policy") == row["policy"])["end_reason"].to_list()
        usual = max(dict.fromkeys(ends), key=ends.count)
        told = [
            tables.words(row["policy"]),
            Cell(escape(control(row["control"])), row["control"]),
            Cell(str(row["trials"]), row["trials"]),
        ]
        told += [
            tables.number(row[name], 2)
            for name in ("mean", "quantile_10", "quantile_50", "quantile_90")
        ]
        rows.append(
            (
                "",
                [
                    *told,
                    Cell(
                        f"{escape(usual)} <small>({ends.count(usual)} of {len(ends)})</small>",
                        usual,
                    ),
                ],
            )
        )
    heads = [
        ("policy", "Policy"),
        ("control", "Control"),
        ("trials", "Flights"),
        ("mean", "Mean [s]"),
    ]
    heads += [(f"quantile_{percent}", f"{percent} % [s]") for percent in (10, 50, 90)]
    return tables.sortable("prediction", [*heads, ("end", "Most frequent end")], rows, found)


def errors(run: Run) -> str:
    """A row a model and horizon of what was validated."""
    if run.validation is None:
        return ""
    shown = {
        "position": (100.0, "cm"),
        "velocity": (1.0, "m/s"),
        "attitude": (57.29578, "°"),
        "body_rates": (1.0, "rad/s"),
    }
    simplest = {
        row["horizon"]: row
        for row in run.validation.iter_rows(named=True)
        if row["model"] == NOTHING_CHANGES
    }
    rows = []
    for row in run.validation.iter_rows(named=True):
        told = [Cell(f"{row['horizon']:g}", row["horizon"]), tables.words(row["model"])]
        for name, (scale, _) in shown.items():
            low, high = (
                f"{scale * row[f'{name}_{end}']:#.3g}".removesuffix(".") for end in ("low", "high")
            )
            worse = (
                " *"
                if row["horizon"] in simplest and row[name] > simplest[row["horizon"]][name]
                else ""
            )
            told.append(
                Cell(
                    f"{scale * row[name]:#.3g}".removesuffix(".")
                    + f"{worse} <small>{low} .. {high}</small>",
                    row[name],
                )
            )
        rows.append(("", told))
    heads = [("horizon", "Ahead [s]"), ("model", "Model")]
    heads += [
        (name, f"{name.replace('_', ' ').capitalize()} [{unit}]")
        for name, (_, unit) in shown.items()
    ]
    return tables.sortable("errors", heads, rows, run.validation)
