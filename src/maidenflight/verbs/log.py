"""`Log`: what flight logs hold, and their conversion into our format."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight.errors import first_few
from maidenflight.settings import flag, setting
from maidenflight.terminal import Table
from maidenflight.verb import Output, Progress, Result, Row, Verb
from maidenflight.verbs import shared

if TYPE_CHECKING:
    from maidenflight.flights.log import Flight
    from maidenflight.flights.reading import Flights
    from maidenflight.flights.summary import Summary

_MARKS = {"fails": "✗", "warns": "!", "passes": "✓", "cannot tell": "?"}
_GOOD = ("passes", "cannot tell")
_UNITS = ("ms", "g")
"""Of measured values, as thresholds end with them; other values are ratios."""
_THRUST = "thrust to weight"
"""The test whose passing says something to compare."""
_STATE = ("position", "velocity", "attitude")
_FEWEST_RANKED, _MOST_RANKED = 3, 10
"""Logs from which on they are ranked, and how many are named."""


class Log(Verb):
    """Show what LOGS hold, and convert them.

    LOGS is a flight log of any format that is read, or a folder of them. Signals, rates, how the
    drone was moved, a check-up of axes, signs, units, clocks and motors against physics, what was
    assumed or dropped, and why files were refused. With -o the usable pieces are written in our
    format, which every command reads.
    """

    output = Output(
        None, "Folder for the logs in our format, a CSV a piece; nothing is written by default."
    )

    logs: Path = shared.logs()
    commands: str | None = shared.commands()
    battery_law: str | None = shared.battery_law()
    map_columns: bool = setting(
        flag(),
        False,
        "Of tables in no known format write NAME.columns.toml beside NAME.csv, which says which "
        "column is which signal, as names and numbers show it; then read them by it.",
        recorded=False,
    )

    def compute(self, output: Path | None, progress: Progress) -> Result:
        """Reads the logs; writes the usable pieces where there is an output."""
        from maidenflight.flights.reading import read_flights
        from maidenflight.flights.summary import summaries as summarize_flights
        from maidenflight.verbs.parts import logs_output

        maps = logs_output.write_maps(self.logs) if self.map_columns else []
        flights = read_flights(
            *(self.logs, logs_output.count_files(progress), math.inf),
            commands=self.commands,
            battery_law=self.battery_law,
            faulty="use",
        )
        record = self.make_record(flights.paths)
        written = [] if output is None else logs_output.write_logs(output, _name(flights), record)
        summaries = summarize_flights(flights)
        logs = [asdict(log) | {"is_calm": log.is_calm} for log in summaries]
        unused = _describe_unused(logs, flights.notes)
        return Result(
            content={
                **logs_output.to_content(flights),
                "logs": logs,
                "checks": {
                    name: [asdict(result) | {"sentence": result.sentence} for result in results]
                    for name, results in flights.checks.items()
                },
                "written": [str(path) for path in [*maps, *written]],
            },
            summary=[
                *(f"columns: {path}; look it through, and mend what is wrong" for path in maps),
                *_tabulate(logs),
                *unused,
                *_tabulate_information(summaries),
                *_tabulate_checks(flights),
                *logs_output.describe_flights(flights, but=unused),
                f"pictures: maidenflight report --logs {self.logs} -o look.html",
            ],
            written={"logs": written} if written else {},
            read={"logs": flights.paths},
            record=record,
            next=("identify", self.logs if output is None else output, "--start", "DRONE"),
            next_remark="DRONE: a name of maidenflight drone --list, or a file"
            + ("; keep every third log elsewhere, for validate" if len(logs) > 2 else ""),
            value=flights,
            error=_count_failing(flights),
        )


def _name(flights: "Flights") -> "dict[str, Flight]":
    """Returns pieces of flight by their log's name, with a number where it has several."""
    names = [Path(flight.name).name.split(".")[0] for flight in flights]
    several, count, named = Counter(names), Counter[str](), {}
    for name, flight in zip(names, flights, strict=True):
        count[name] += 1
        named[f"{name}_{count[name]}" if several[name] > 1 else name] = flight
    return named


def _tabulate_checks(flights: "Flights") -> list[Table | str]:
    """Returns a row for each test that a log does not pass, what is wrong, and how many pass."""
    from maidenflight.flights.checkup.result import warning_lines

    tests: dict[str, list[Any]] = {}
    for results in flights.checks.values():
        for result in results:
            tests.setdefault(result.name, []).append(result)
    rows, unknown = [], []
    for name, results in tests.items():
        counts = Counter(result.verdict for result in results)
        if counts["passes"] == len(results):
            continue
        if counts["passes"] + counts["cannot tell"] == len(results):
            unknown.append(name.replace("_", " "))
            continue
        several = len(flights.checks) > 1
        counts_text = [
            f"{_MARKS[verdict]} {verdict}{f' {counts[verdict]}' if several else ''}"
            for verdict in _MARKS
            if counts[verdict]
        ]
        statistics = [result.statistic for result in results if result.statistic is not None]
        low, high = (f"{edge(statistics):.3g}" if statistics else "" for edge in (min, max))
        threshold = next((result.threshold for result in results if result.threshold), "")
        unit = next((f" {unit}" for unit in _UNITS if threshold.endswith(f" {unit}")), "")
        rows.append(
            {
                "test": name.replace("_", " "),
                "result": ", ".join(counts_text),
                "measured": (low if low == high else f"{low} .. {high}") + (unit if low else ""),
                "threshold": threshold,
            }
        )
    faults = warning_lines(flights.warnings, marks=("✗ ", "! "))
    if not tests:
        return [*faults]
    columns = {"test": "{test}", "result": "{result}", "measured": "{measured}"}
    columns |= {"expected": "{threshold}"}
    passed = len(tests) - len(rows) - len(unknown)
    of = f"Check-up against physics: {passed} of {len(tests)} tests pass in every log"
    of += f"; some logs cannot tell {', '.join(unknown)}" if unknown else ""
    return [
        *([Table("Check-up against physics", columns, rows)] if rows else []),
        *faults,
        f"{of}. Measured values: --json.",
        *(
            f"{_THRUST}: {result.sentence}"
            for result in tests.get(_THRUST, ())[:1]
            if result.verdict in _GOOD
        ),
    ]


def _describe_unused(logs: list[Row], notes: Sequence[str]) -> list[str]:
    """Returns which signals no log gives, each with the note that says why, if one does."""
    from maidenflight.flights.log import OPTIONAL

    signals = {name for log in logs for name in log["signals"]}
    reasons: dict[str, list[str]] = {}
    for signal in (*_STATE, "accelerometer", "rotor_speed", "battery"):
        if signal in signals:
            continue
        words = signal.replace("_", " ")
        names = (words, *OPTIONAL.get(signal, ())[:1])
        about = (note for note in notes if any(name in note.partition(": ")[2] for name in names))
        note = next(about, "")
        reasons.setdefault(note.partition(": ")[2] or "not logged", []).append(words)
    return [f"not used: {', '.join(names)} ({reason})" for reason, names in reasons.items()]


def _count_failing(flights: "Flights") -> str:
    """Returns how many logs other commands refuse; "" if none."""
    failing = [
        name
        for name, results in flights.checks.items()
        if any(result.verdict == "fails" for result in results)
    ]
    if not failing:
        return ""
    return (
        f"{len(failing)} of {len(flights.checks)} logs contradict physics ({first_few(failing)}) "
        "and are refused by other commands, with the others of their folder. Mend what stands "
        "behind each ✗."
    )


def _tabulate_information(logs: "Sequence[Summary]") -> list[Table | str]:
    """Returns which logs tell most of which quantity, where there are enough to choose from."""
    from maidenflight.flights.summary import choose_most_telling
    from maidenflight.flights.summary import rank as rank_logs

    if len(logs) < _FEWEST_RANKED:
        return []
    ranked = rank_logs(logs)
    rows = [{"log": log.name, **shares} for log, shares in ranked[:_MOST_RANKED]]
    columns = {"log": "{log}"} | {name: f"{{{name}:.0%}}" for name in ranked[0][1]}
    chosen = [log.name for log in choose_most_telling(ranked)]
    return [
        Table("Shares of what all logs tell", columns, rows),
        f"{len(chosen)} of {len(logs)} logs hold 80 % of each, the most telling first: "
        f"{first_few(chosen, most=_MOST_RANKED)}.",
    ]


def _tabulate(logs: list[Row]) -> list[Table | str]:
    """Returns what logs hold and how they move the drone, a row each."""
    rows = []
    for log in logs:
        signals = [name.replace("_", " ") for name in log["signals"] if name not in _STATE]
        state = [", ".join(_STATE)] if set(_STATE) <= set(log["signals"]) else []
        battery = (
            "unknown" if log["battery"] is None else "{:.2f} .. {:.2f} V".format(*log["battery"])
        )
        rows.append({**log, "signals": ", ".join([*state, *signals]), "battery": battery})
    alike = len({row["signals"] for row in rows}) == 1
    holding = {"log": "{name}"} | ({} if alike else {"signals": "{signals}"})
    holding |= {"commands": "{commands}", "usable": "{seconds:.1f s}"}
    holding |= {"rate, by\ntime stamps": "{rate:.4g Hz}", "battery": "{battery}"}
    motion = {"log": "{name}", "speed": "{speed:.2f m/s}", "largest\ntilt": "{tilt:.0f deg}"}
    motion |= {"body\nrates": "{body_rates:.0f deg/s}", "mean\ncommand": "{command:.3f}"}
    motion |= {"SD of\nthrust": "{thrust_spread:.3f}", "SD of\ntorque": "{torque_spread:.3f}"}
    calm = [log["name"] for log in logs if log["is_calm"]]
    which = f" ({first_few(calm)})" if len(calm) < len(logs) else ""
    remark = (
        f"{len(calm)} of {len(logs)} logs are calm{which}: the motors differ little. Quick rolls "
        "and pitches determine inertia, lag and latency better."
    )
    return [
        Table("Flight logs", holding, rows, ("battery",)),
        *([f"Every log has {rows[0]['signals']}."] if alike else []),
        Table("Motion of the drone", motion, rows, (*motion,)[:3:-1]),
        "Speed and body rates are root mean squares. Commands are shares of full thrust; SD is the "
        "standard deviation of their mean (thrust) and their difference in roll or pitch (torque).",
        *([remark] if calm else []),
    ]
