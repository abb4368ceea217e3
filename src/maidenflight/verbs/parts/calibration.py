"""`validate --calibration`: how often intervals hold the truth, for one drone and its logs."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight import results, run_folder
from maidenflight.errors import InputError
from maidenflight.terminal import Table
from maidenflight.verb import Progress, Result, Row, Verb
from maidenflight.verbs import shared
from maidenflight.verbs.identify import Identify

if TYPE_CHECKING:
    from maidenflight.flights.reading import Flights
    from maidenflight.identification.drone_file import DroneFile
    from maidenflight.identification.outcome.estimates import Identification
    from maidenflight.identification.outcome.progress import Progress as Stage

BUDGET_S = 280.0
"""Time after which no drone is begun any more, if it would end later [s]."""
_BAR_STEPS = 1000
_MOST_LOST = 5
"""Drones, none of which stays on the paths, after which no other is tried."""


def identification_of(drone: Path, logs: Path) -> tuple["DroneFile", Identify]:
    """Returns a drone file, and the identification that its record describes, of other logs.

    Raises:
        InputError: it was not identified by likelihood, or by what is not there any more.
    """
    from maidenflight import parameters
    from maidenflight.identification import drone_file

    file = drone_file.read(drone)
    settings = file.record.get("settings", {})
    if not isinstance(settings, dict) or settings.get("objective") != "likelihood":
        raise InputError(
            f"{drone}: its record does not say how it was identified by likelihood. Identify it: "
            f"maidenflight identify {logs} -o {drone}."
        )
    known = {name: settings[name] for name in Identify.settings() if name in settings}
    # Of what the flights chose, the record lists the result.
    known["over"] = "auto" if file.gains else settings.get("over")
    start = str(known.get("start", "crazyflie"))
    if start not in parameters.DRONES:
        known["start"] = _find_start(drone, file, start)
    return file, Identify(**(known | {"logs": logs, "seed": file.record.get("seed", 0)}))


def _find_start(drone: Path, file: "DroneFile", name: str) -> str:
    """Returns the file from which an identification began, beside its result or here."""
    digests = results.recorded_inputs(file.record, str(drone))
    for path in (drone.parent / name, Path(name)):
        if path.is_file() and results.digest(path) in digests:
            return str(path)
    raise InputError(
        f"{drone}: it was identified with --start {name}, which is neither here nor beside it, or "
        "has changed. Put it there, or identify again."
    )


class _Clock:
    """Decides how many drones there is time for."""

    def __init__(self, draws: int | None) -> None:
        self.draws, self.done, self.lost = draws, 0, 0
        self._began = self._last = time.monotonic()
        self._longest = 0.0

    @property
    def share(self) -> float:
        """Share of the work that is done."""
        spent = (time.monotonic() - self._began) / BUDGET_S
        return min(spent, 1.0) if self.draws is None else self.done / self.draws

    def count(self, is_lost: bool) -> bool:
        """Counts a drone; returns whether it was the last one."""
        self.done, self.lost = self.done + 1, self.lost + is_lost
        now = time.monotonic()
        # The first one compiles, for more than half of its time.
        took = (now - self._last) * (0.4 if self.done == 1 else 1.0)
        self._longest = max(took, 0.0 if self.done == 2 else self._longest)
        self._last = now
        if self.draws is not None:
            return self.done == self.draws
        return self.lost == self.done == _MOST_LOST or (
            now - self._began + self._longest > BUDGET_S
        )


def calibrate(
    verb: Verb, drone: str, logs: Path, draws: int | None, output: Path, progress: Progress
) -> Result:
    """Identifies drones of the posterior from flights along the logs; writes a table.

    Args:
        verb: whose key and settings count.
        drone: the drone's file.
        logs: a log or a folder of them.
        draws: drones to draw; as many as there is time for by default.
        output: the table.
        progress: called with the progress.

    Raises:
        InputError: see `identification_of`, or no drone stays on the paths.
    """
    from polars import DataFrame

    from maidenflight.identification.calibration import draw_calibrations
    from maidenflight.identification.calibration import summarize as summarize_calibration
    from maidenflight.identification.outcome.progress import Overall
    from maidenflight.verbs.parts import logs_output

    clock, rows = _Clock(draws), list[Row]()
    file, identify = identification_of(Path(drone), logs)
    flights = identify.read(logs_output.count_files(progress))

    def again(logs: Any, key: Any) -> "Identification":
        overall = Overall()

        def move(now: "Stage") -> None:
            remark = f"drone {clock.done + 1}, {overall.reach(now)[1]}"
            progress.move(int(_BAR_STEPS * clock.share), _BAR_STEPS, remark)

        return identify.identify(logs, key, move)

    progress.move(0, _BAR_STEPS, "compiling, and flying the first drone")
    for drawn in draw_calibrations(flights.flights, file, again, verb.key):
        rows += [{"draw": clock.done, **row} for row in drawn]
        if clock.count(is_lost=not drawn):
            break
    if not rows:
        raise InputError(
            f"{drone}: none of {clock.done} drones of its posterior stays on the paths of "
            "these logs in simulation. Identify it from more flights."
        )
    table = DataFrame(rows, infer_schema_length=None)
    own, notes = shared.own_files(drone), _notes(file, flights, clock)
    record = verb.make_record([*own, *flights.paths], draws=clock.done)
    run_folder.CALIBRATION.write(output, table, record)
    summary = summarize_calibration(table)
    return Result(
        content={"draws": clock.done, "lost": clock.lost, "parameters": summary}
        | {"notes": notes, "output": str(output)},
        summary=_summarize(summary, clock.done - clock.lost),
        written={"calibration": [output]},
        read={"drone": own, "logs": flights.paths},
        record=record,
        rows=summary,
        notes=notes,
        next=("report",),
        value=table,
    )


def _notes(file: "DroneFile", flights: "Flights", clock: _Clock) -> list[str]:
    """Returns in what the drones or logs are not those of the file."""
    digests = results.recorded_inputs(file.record, file.name)
    notes = []
    if not {results.digest(path) for path in flights.paths} <= digests.keys():
        notes.append(
            "these are not the logs that the drone was identified from: widths are compared with "
            "those from other flights."
        )
    if clock.lost:
        notes.append(
            f"{clock.lost} of {clock.done} drones did not stay on the paths, and are left out."
        )
    return notes


def _summarize(summary: list[Row], draws: int) -> list[Table | str]:
    """Returns the table of parameters, and in words which intervals are too narrow."""
    from maidenflight.identification.calibration import uniform_band

    rows = []
    for row in summary:
        width = row["width_ratio"]
        rows.append(
            {"name": row["parameter"], "held": f"{row['held']} of {row['in_model']}"}
            | {"width": "" if width is None else f"{width:.2f}"}
            | {"ranks": " ".join(f"{count:d}" for count in row["ranks"])}
            | {"verdict": _verdict(row)}
        )
    low, high = uniform_band(draws)
    columns = {"parameter": "{name}", "truth in the\n95 % interval": "{held}"}
    columns |= {"width over\nthe file's": "{width}", "ranks": "{ranks}", "": "{verdict}"}
    narrow = [row["parameter"] for row in summary if not row["enough"]]
    return [
        f"intervals that hold the truth too rarely: {', '.join(narrow)}"
        if narrow
        else f"no interval holds the truth too rarely, as far as {draws} drones tell",
        Table(f"{draws} drones of the posterior, identified again", columns, rows),
        f"ranks: of the truth among the posterior samples, from lowest to highest; of {draws} "
        f"uniform ones a bin holds {low} to {high} (99 %)",
    ]


def _verdict(row: Row) -> str:
    """Returns what is wrong with the intervals of a parameter, in words."""
    if not row["in_model"]:
        return "not in the model"
    remarks = [] if row["enough"] else ["too narrow"]
    ranks = row["ranks"]
    if not row["uniform"] and max(ranks) > ranks[len(ranks) // 2]:
        low, high = sum(ranks[:2]), sum(ranks[-2:])
        remarks.append("found too high" if low > high else "found too low")
    elif not row["uniform"]:
        remarks.append("wider than needed")
    return ", ".join(remarks)
