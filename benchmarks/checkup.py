"""Measures how often the check-up names logs that were spoilt on purpose, and how often sound ones.

Writes paper/notes/checkup.md. Thresholds were set while looking at the first set of logs alone; the
second set, other logs of the same and of other sources, was first tried with all of them fixed.
"""

import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import click
import jax
from page import write

import maidenflight as mf
from maidenflight.errors import InputError, require_packages
from maidenflight.flights.checkup.checkup import check_up
from maidenflight.flights.checkup.result import FAILS, UNKNOWN, WARNS, CheckResult
from maidenflight.flights.log import Flight
from maidenflight.flights.reading import read_flights

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "common"))
from spoilings import SPOILINGS, Spoiling, is_told

PAGE = Path(__file__).parent.parent / "paper" / "notes" / "checkup.md"
Logs = dict[str, tuple[Flight, ...]]
LONGEST_S = 40.0
"""Of a log that is spoilt [s]; more only takes more time."""
SHORTEST_S = 3.0
"""Of a log that is spoilt [s]."""
PATTERNS: Mapping[str, Sequence[str]] = {
    "first": (
        *("nanobench/*.csv.gz", "usd/brushed/jana*", "usd/brushless/eckart*"),
        *("usd/payload/eckart*", "usd_imu/log*", "real/simpleflight/cf*", "real/betaflight/*.BFL"),
        "real/indiflight/*.BFL",
    ),
    "second": ("real/neural_swarm/randomwalk*",),
}
EVERY = {"first": 3, "second": 2}
"""Each so many logs of a set are spoilt; false alarms are counted in all of them."""
_ALARMS = (FAILS, WARNS)
OF_SCALE = ("sqrt(u) for u", "u squared", "u halved", "u times 1.25")
"""Of which physics tells little: what hovers at half of u has twice the thrust."""


def read_set(which: str, data: Path) -> Logs:
    """Reads the logs of a set, and flies virtual drones of other seeds for each."""
    files = [file for one in PATTERNS[which] for file in sorted(data.glob(one))]
    for folder in ("attitude", "attitude_rate"):
        theirs = sorted((data / "authors" / "flights" / folder).rglob("*.csv.gz"))
        first = theirs[::6]
        files += first if which == "first" else [file for file in theirs if file not in first][::2]
    logs: Logs = {}
    for file in files:
        try:
            flights = read_flights(file, faulty="use").flights
        except InputError:
            continue
        logs["/".join(file.parts[-2:])] = flights
    for seed in range(4) if which == "first" else range(20, 28):
        rate = 500 if which == "first" or seed % 2 else 100
        (flight,) = mf.record(
            mf.virtual_drone(seed), jax.random.key(seed), flights=1, duration=20.0, rate=rate
        )
        logs[f"virtual:{seed}"] = (replace(flight, name=f"virtual:{seed}"),)
    return logs


def _shorten(pieces: Sequence[Flight]) -> list[Flight]:
    parts, left = [], LONGEST_S
    for piece in sorted(pieces, key=len, reverse=True):
        rows = min(len(piece), round(left / piece.period))
        if rows * piece.period > 0.3:
            parts.append(piece.part(0, rows))
            left -= rows * piece.period
    return parts


def _concerns(spoiling: Spoiling, pieces: Sequence[Flight]) -> bool:
    if sum(piece.duration for piece in pieces) < SHORTEST_S:
        return False
    if spoiling.needs == "state":
        return pieces[0].has_state
    return not spoiling.needs or getattr(pieces[0], spoiling.needs) is not None


def judge(name: str, spoiling: Spoiling, results: Sequence[CheckResult]) -> str:
    """Says whether a fault was named, what to compare was, or it cannot be told or was missed."""
    own = [one.verdict for one in results if one.name in spoiling.tests]
    if any(verdict in _ALARMS for verdict in own):
        return "named"
    if own and name in OF_SCALE and any("compare" in one.sentence for one in results):
        return "to compare"
    # A test that another one's failure keeps from running cannot tell either.
    return "cannot tell" if all(verdict == UNKNOWN for verdict in own) else "missed"


def measure(
    logs: Logs, every: int, only: str, report: list[str]
) -> Iterator[tuple[str, Counter[str]]]:
    """Spoils each so many logs in each way, and counts the judgements."""
    short = {name: _shorten(logs[name]) for name in list(logs)[::every]}
    for name, spoiling in SPOILINGS.items():
        if only not in name:
            continue
        counts: Counter[str] = Counter()
        for log_name, pieces in short.items():
            if not _concerns(spoiling, pieces):
                continue
            spoilt = [spoiling.apply(piece) for piece in pieces]
            if not is_told(name, pieces[0], spoilt[0]):
                counts["no fault"] += 1
                continue
            verdict = judge(name, spoiling, check_up(spoilt))
            counts[verdict] += 1
            if verdict == "missed":
                report.append(f"missed: {name} in {log_name}")
        yield name, counts


def alarms(logs: Logs, report: list[str]) -> tuple[Counter[str], int]:
    """Counts false alarms by test, and the logs that raise one."""
    counts: Counter[str] = Counter()
    alarmed = 0
    for name, pieces in logs.items():
        raised = [one for one in check_up(pieces) if one.verdict in _ALARMS] if pieces else []
        counts.update(one.name for one in raised)
        alarmed += bool(raised)
        report.extend(f"alarm: {name}: {one.name}: {one.sentence}" for one in raised)
    return counts, alarmed


def _row(name: str, cells: Sequence[Counter[str]]) -> str:
    table_rows = []
    for counts in cells:
        total = counts["named"] + counts["missed"]
        table_rows.append(f"{counts['named']} of {total}" if total else "-")
        other = str(counts["cannot tell"] + counts["no fault"])
        compare = counts["to compare"]
        table_rows.append(f"{other}, {compare} to compare" if compare else other)
    return f"| {name} | {' | '.join(table_rows)} |"


@click.command()
@click.option("--data", type=click.Path(path_type=Path, exists=True), default="../shared/data")
@click.option("--only", default="", help="Spoilings whose name contains this.")
def main(data: Path, only: str) -> None:
    """Measures both sets and writes the page."""
    require_packages("rosbags", "pyulog", "orangebox", "pymavlink")
    tables: dict[str, dict[str, Counter[str]]] = {}
    lines, report = [], []
    for which in PATTERNS:
        logs = read_set(which, data)
        counts, alarmed = alarms(logs, report)
        tests = ", ".join(f"{test} {count}" for test, count in counts.items()) or "none"
        lines.append(
            f"- {which} set: {alarmed} of {len(logs)} sound logs raise an alarm"
            f" ({100 * alarmed / len(logs):.1f} %; by test: {tests})"
        )
        click.echo(lines[-1])
        tables[which], total = {}, Counter[str]()
        for name, result in measure(logs, EVERY[which], only, report):
            tables[which][name] = result
            total.update(result)
            click.echo(f"  {which} {name}: {dict(result)}")
        judged = total["named"] + total["missed"]
        lines.append(
            f"- {which} set: {total['named']} of {judged} faults are named "
            f"({100 * total['named'] / max(judged, 1):.1f} %); of {total['cannot tell']} the "
            f"check-up says that it cannot tell, {total['no fault']} change nothing, "
            f"{total['to compare']} are to compare"
        )
        click.echo(lines[-1])
    click.echo("\n".join(report))
    if only:
        return
    head = "| spoilt | first set: named | cannot tell | second set: named | cannot tell |"
    rows = [_row(name, [tables[which][name] for which in PATTERNS]) for name in SPOILINGS]
    write(
        PAGE,
        {
            "alarms": "\n".join(lines),
            "spoilings": "\n".join([head, "|---|---|---|---|---|", *rows]),
        },
    )


if __name__ == "__main__":
    main()
