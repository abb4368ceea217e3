"""The page's tables of flights: a row a test flight or a predicted policy."""

import polars
from markupsafe import Markup

from maidenflight.experiments import flight_times, recovery
from maidenflight.flights.trims import trim
from maidenflight.identification.replay.prediction import PERSISTENCE
from maidenflight.parameters import crazyflie
from maidenflight.reporting import tables
from maidenflight.reporting.run import Run, viewable
from maidenflight.reporting.tables import Cell
from maidenflight.reporting.text import ERRORS

MICRO = 1e6
"""Shown trim per N m."""
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
    "command_change": "Change of commands in 10 ms [%]",
    "at_limits": "Commands at a limit [%]",
}
_ACTIVITY = ("command_change", "at_limits")
"""Of flights of which it was measured."""


def _control(name: str) -> Cell:
    return Cell(NAMES.get(name, name), name)


def flights(run: Run) -> Markup | str:
    """The test flights, for sorting and for choosing what the viewer shows."""
    if run.table is None:
        return ""
    viewed, rows = set(viewable(run)), []
    for place, row in enumerate(run.table.iter_rows(named=True)):
        number, name = row["flight"], f"flight {row['flight']}"
        rows.append(
            [
                tables.choice(number, name) if place in viewed else tables.plain(number),
                *(tables.plain(row[column]) for column in ("policy", "reality")),
                Cell(str(row["trial"]), str(row["trial"])),
                tables.number(row["duration"], 2),
                tables.plain(row["end_reason"]),
                tables.number(row["position_error"], 2, 100.0),
                *(tables.number(row[column], 1, 100.0) for column in _ACTIVITY if column in row),
            ]
        )
    heads = [(name, head) for name, head in _COLUMNS.items() if name in run.table.columns]
    columns = [name for name, _ in heads]
    return tables.sortable("flights", heads, rows, run.table.select(columns), of_flights=True)


def trims(run: Run) -> polars.DataFrame:
    """What each recorded flight says cheaply, a row a flight, in SI units; see `trims.trim`."""
    drone = crazyflie() if run.drone is None else run.drone.parameters
    rows = []
    for number, flight in enumerate(run.recorded, 1):
        found = trim([flight], drone)
        row = {"number": number, "flight": flight.name}
        row |= {"drone": flight.simulated or "a real drone"}
        row |= {"duration": flight.duration, "rows": len(flight)}
        row |= {"thrust_to_weight": found.thrust_to_weight}
        row |= {"thrust_to_weight_error": found.thrust_to_weight_error}
        for axis, value, error in zip(
            "xyz", found.torque_bias, found.torque_bias_error, strict=True
        ):
            row |= {f"torque_bias_{axis}": float(value), f"torque_bias_{axis}_error": float(error)}
        row |= {f"command_{motor}": float(mean) for motor, mean in enumerate(found.command, 1)}
        rows.append(row | {"battery": found.battery})
    return polars.DataFrame(rows)


def recorded(run: Run) -> Markup | str:
    """The recorded flights, for choosing what the viewer shows."""
    if not run.recorded:
        return ""
    viewed, rows, file = set(viewable(run)), [], trims(run)
    for place, row in enumerate(file.iter_rows(named=True)):
        name = row["flight"]
        rows.append(
            [
                tables.choice(name, name) if place in viewed else tables.plain(name),
                tables.plain(row["drone"]),
                tables.number(row["duration"], 2),
                tables.number(row["thrust_to_weight"], 3),
                *(tables.number(row[f"torque_bias_{axis}"], 0, MICRO) for axis in "xyz"),
                *(tables.number(row[f"command_{motor}"], 3) for motor in range(1, 5)),
                tables.number(row["battery"], 2),
            ]
        )
    heads: list[tuple[str, str | Markup]] = [("flight", "Flight"), ("drone", "Drone")]
    heads += [("duration", "Duration [s]"), ("thrust_to_weight", "Thrust to weight")]
    unit = Markup("10<sup>\N{MINUS SIGN}6</sup> N m")
    heads += [
        (f"torque_bias_{axis}", Markup("{} trim [{}]").format(name, unit))
        for axis, name in zip("xyz", ("Roll", "Pitch", "Yaw"), strict=True)
    ]
    heads += [(f"command_{motor}", f"Mean u of motor {motor}") for motor in range(1, 5)]
    heads += [("battery", "Battery [V]")]
    return tables.sortable("flights", heads, rows, file, of_flights=True)


def recoveries(found: polars.DataFrame) -> Markup:
    """A row a reality and policy of flights whose drone changes.

    Args:
        found: a row a flight, as `recovery.of_flights` gives them.
    """
    table, rows = recovery.summary(found), []
    for row in table.iter_rows(named=True):
        names = ("reality", "policy", "flights", "lasting", "soon")
        cells = [tables.plain(row[name]) for name in names]
        rows.append([*cells, tables.number(row["recovery"], 2)])
    within = f"{100 * recovery.WITHIN_M:g} cm"
    heads = [("reality", "Drone"), ("policy", "Policy"), ("flights", "Flights")]
    heads += [("lasting", "To the end"), ("soon", f"Back within {within} in {recovery.SOON_S:g} s")]
    heads += [("recovery", "Median time to be back [s]")]
    return tables.sortable("recoveries", heads, rows, table)


def predictions(run: Run) -> Markup | str:
    """A row a policy whose flights are predicted."""
    if run.prediction is None:
        return ""
    found, rows = flight_times.summary(run.prediction), []
    times = ("mean", "quantile_10", "quantile_50", "quantile_90")
    for row in found.iter_rows(named=True):
        ends = run.prediction.filter(polars.col("policy") == row["policy"])["end_reason"].to_list()
        usual = max(dict.fromkeys(ends), key=ends.count)
        shown = Markup("{} <small>({} of {})</small>").format(usual, ends.count(usual), len(ends))
        rows.append(
            [
                tables.plain(row["policy"]),
                _control(row["control"]),
                tables.plain(row["trials"]),
                *(tables.number(row[name], 2) for name in times),
                Cell(shown, usual),
            ]
        )
    heads = [("policy", "Policy"), ("control", "Control"), ("trials", "Flights")]
    heads += zip(times, ("Mean [s]", "10 % [s]", "50 % [s]", "90 % [s]"), strict=True)
    return tables.sortable("prediction", [*heads, ("end", "Most frequent end")], rows, found)


def errors(run: Run) -> Markup | str:
    """A row a model and horizon; * marks what is worse than the persistence baseline."""
    if run.validation is None:
        return ""
    baseline = {
        row["horizon"]: row
        for row in run.validation.iter_rows(named=True)
        if row["model"] == PERSISTENCE
    }
    rows = []
    for row in run.validation.iter_rows(named=True):
        cells = [Cell(f"{row['horizon']:g}", row["horizon"]), tables.plain(row["model"])]
        for name, shown in ERRORS.items():
            value, low, high = (
                f"{shown.scale * row[f'{name}{end}']:#.3g}".removesuffix(".")
                for end in ("", "_low", "_high")
            )
            worse = row[name] > baseline.get(row["horizon"], {}).get(name, float("inf"))
            cell = Markup("{}{} <small>{} .. {}</small>")
            cells.append(Cell(cell.format(value, " *" if worse else "", low, high), row[name]))
        rows.append(cells)
    heads = [("horizon", "Ahead [s]"), ("model", "Model")]
    heads += [(name, f"{shown.name.capitalize()} [{shown.unit}]") for name, shown in ERRORS.items()]
    return tables.sortable("errors", heads, rows, run.validation)
