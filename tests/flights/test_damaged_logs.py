"""Damaged logs: each is made from a good one, and each is refused, or loses rows, in words that
name the file and the place."""

import gzip
import io
import os
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import polars
import pytest

from made_flights import driven
from maidenflight.errors import InputError
from maidenflight.flights import flight_csv
from maidenflight.flights.reading import read_flights
from maidenflight.verbs.parts import logs_output

ROWS = 900
FIRST = 6
"""Line of the first row in our format."""


@cache
def good():
    """The text of a log in our format that has nothing to complain about."""
    return flight_csv.to_csv(driven(ROWS))


def lines(change: Callable[[list[str]], object]):
    """The good log after a change of its lines."""
    given = good().rstrip("\n").split("\n")
    changed = change(given)
    return "\n".join(changed if isinstance(changed, list) else given) + "\n"


def cell(row: int, column: str, value: str):
    """The good log with one cell changed; rows count from 1."""
    names = good().split("\n")[4].split(",")

    def change(given: list[str]) -> None:
        cells = given[4 + row].split(",")
        cells[names.index(column)] = value
        given[4 + row] = ",".join(cells)

    return lines(change)


def columns(**changes: Callable[[polars.Expr], polars.Expr] | polars.Expr):
    """The good log with whole columns changed."""
    given = good()
    head, body = given.split("\n")[:4], given.split("\n", 4)[4]
    frame = polars.read_csv(io.StringIO(body))
    frame = frame.with_columns(
        **{
            name: change(polars.col(name)) if callable(change) else change
            for name, change in changes.items()
        }
    )
    return "\n".join(head) + "\n" + frame.write_csv(float_precision=7)


def flight(**groups: Callable[[np.ndarray], np.ndarray]):
    """The good flight with whole groups of columns changed."""
    made = driven(ROWS)
    return flight_csv.to_csv(
        replace(made, **{group: change(getattr(made, group)) for group, change in groups.items()})
    )


def shuffled():
    made, rows = driven(ROWS), np.random.default_rng(0).permutation(ROWS)
    groups = ("position", "velocity", "attitude", "body_rates", "command")
    large = replace(
        made,
        position=made.position * np.array([4, 4, 1], np.float32),
        velocity=made.velocity * np.array([4, 4, 1], np.float32),
    )
    return flight_csv.to_csv(
        replace(large, **{group: getattr(large, group)[rows] for group in groups})
    )


def order(*motors: int):
    return lambda command: command[:, list(motors)]


def signs(*factors: float):
    return lambda values: values * np.array(factors, np.float32)


REFUSED: dict[str, tuple[Callable[[], str | bytes], str]] = {
    "binary content": (lambda: np.random.default_rng(0).bytes(2000), r"bad\.csv: cannot be read"),
    "zeros": (lambda: b"\x00" * 500, r"line 1 is binary"),
    "an empty file": (lambda: b"", r"the file is empty"),
    "blank lines only": (lambda: b"\n\n\n", r"the file is empty"),
    "a header and nothing else": (
        lambda: lines(lambda all_: all_[:5]),
        r"no rows below the header in line 5",
    ),
    "a truncated gzip": (lambda: gzip.compress(good().encode())[:-500], r"cannot be read"),
    "a gzip of a gzip": (
        lambda: gzip.compress(gzip.compress(good().encode())),
        r"compressed twice",
    ),
    "Parquet cut in half": (lambda: b"PAR1" + b"\x00" * 300, r"not a readable Parquet file"),
    "UTF-16": (lambda: good().encode("utf-16"), r"UTF-16.*UTF-8"),
    "Latin letters": (
        lambda: good().encode().replace(b"simulated: no", b"simulated: \xe9"),
        r"line 3 is not UTF-8",
    ),
    "semicolons": (lambda: good().replace(",", ";"), r"semicolons in line 5"),
    "tabs": (lambda: good().replace(",", "\t"), r"tabs in line 5"),
    "decimal commas": (
        lambda: lines(lambda all_: [line.replace(",", ";").replace(".", ",") for line in all_]),
        r"semicolons in line",
    ),
    "a header twice": (
        lambda: lines(lambda all_: all_.insert(100, all_[4])),
        r"column time .*'time' in line 101.*Split them",
    ),
    "a column twice": (
        lambda: good().replace("roll,pitch,yaw", "roll,roll,yaw"),
        r"column 'roll' is there twice in line 5",
    ),
    "no header": (
        lambda: lines(lambda all_: all_.pop(4)),
        r"line 5 holds numbers, expected the columns' names",
    ),
    "no first line": (
        lambda: lines(lambda all_: all_.pop(0)),
        r"line 1 is not '# maidenflight flight 3'",
    ),
    "another version": (
        lambda: good().replace("flight 3:", "flight 9:"),
        r"line 1 is not '# maidenflight flight 3' but '.*flight 9",
    ),
    "no word on commands": (
        lambda: lines(lambda all_: all_.pop(1)),
        r"line 2 is not '# commands: zero-order-hold'",
    ),
    "a column missing": (
        lambda: good().replace("body_rate_y", "other"),
        r"missing column body_rate_y",
    ),
    "a cell too many": (
        lambda: lines(lambda all_: all_.__setitem__(50, all_[50] + ",1")),
        r"line 51 has 22 cells, the header 21",
    ),
    "a word in a number's place": (
        lambda: cell(30, "velocity_y", "fast"),
        rf"column velocity_y .*'fast' in line {FIRST + 29}",
    ),
    "dates for times": (
        lambda: cell(1, "time", "2024-05-01 12:00:00"),
        r"column time .*'2024-05-01 12:00:00' in line 6",
    ),
    "time in milliseconds": (
        lambda: columns(time=lambda c: c * 1000),
        r"rows are 10 s apart.*milliseconds",
    ),
    "time reversed": (
        lambda: columns(time=lambda c: c.reverse()),
        r"runs backwards \(from row 2\)",
    ),
    "time constant": (lambda: columns(time=lambda c: c * 0), r"stands still \(from row 2\)"),
    "time missing in a row": (
        lambda: cell(42, "time", ""),
        r"time is not a finite number in row 42",
    ),
    "time shuffled": (lambda: columns(time=lambda c: c.shuffle(3)), r"not equally spaced"),
    "degrees": (
        lambda: flight(attitude=signs(57.3, 57.3, 57.3)),
        r"roll, pitch .*expected rad, it looks like degrees",
    ),
    "degrees a second": (
        lambda: flight(body_rates=signs(57.3, 57.3, 57.3)),
        r"body_rate.*(expected rad/s|times the change of attitude)",
    ),
    "yaw rate in degrees a second": (lambda: flight(body_rates=signs(1, 1, 57.3)), r"body_rate"),
    "millimetres": (
        lambda: flight(position=signs(1e3, 1e3, 1e3)),
        r"position .*expected m, it looks like millimetres",
    ),
    "centimetres": (
        lambda: flight(position=signs(100, 100, 100)),
        r"position and velocity contradict each other in \d+ of 899 rows",
    ),
    "millimetres a second": (
        lambda: flight(velocity=signs(1e3, 1e3, 1e3)),
        r"velocity .*millimetres a second",
    ),
    "velocity in g": (
        lambda: flight(velocity=signs(1 / 9.81, 1 / 9.81, 1 / 9.81)),
        r"velocity is 0\.10\d times",
    ),
    "PWM counts": (
        lambda: flight(command=signs(65535, 65535, 65535, 65535)),
        r"command .*PWM counts",
    ),
    "actions": (lambda: flight(command=lambda u: 2 * u - 1.6), r"command .*actions a in \[-1, 1\]"),
    "millivolts": (
        lambda: columns(battery=lambda c: c * 1000),
        r"battery .*expected V, it looks like millivolts",
    ),
    "rows shuffled": (lambda: shuffled(), r"contradict each other in \d+ of"),
    "nose up": (
        lambda: flight(attitude=signs(1, -1, 1)),
        r"with y with the opposite sign.*nose up",
    ),
    "nose up, rate too": (
        lambda: flight(attitude=signs(1, -1, 1), body_rates=signs(1, -1, 1)),
        r"tilt .* pitch and yaw with opposite signs.*nose down here",
    ),
    "roll the other way": (
        lambda: flight(attitude=signs(-1, 1, 1)),
        r"body_rate and the change of attitude match .* x with the opposite sign",
    ),
    "yaw rate the other way": (
        lambda: flight(body_rates=signs(1, 1, -1)),
        r"body_rate .* z with the opposite sign",
    ),
    "z down": (
        lambda: flight(velocity=signs(1, 1, -1)),
        r"velocity and the change of position match .* z with the opposite sign",
    ),
    "x and y swapped in velocity": (
        lambda: flight(velocity=order(1, 0, 2)),
        r"velocity .* with x and y swapped",
    ),
    "x and y swapped in both": (
        lambda: flight(velocity=order(1, 0, 2), position=order(1, 0, 2)),
        r"tilt .* x and y of the world swapped",
    ),
    "roll and pitch swapped": (
        lambda: flight(attitude=order(1, 0, 2)),
        r"body_rate .* with x and y swapped",
    ),
    "motors turned by one": (
        lambda: flight(command=order(1, 2, 3, 0)),
        r"in the order command_4, command_1.*look permuted",
    ),
    "motors from the back": (lambda: flight(command=order(2, 3, 0, 1)), r"motors look permuted"),
    "motors mirrored": (lambda: flight(command=order(3, 2, 1, 0)), r"motors look permuted"),
    "columns shuffled": (
        lambda: lines(lambda all_: all_.__setitem__(4, ",".join(np.roll(all_[4].split(","), 3)))),
        r"not equally spaced|time is not a finite number|rows are",
    ),
    "body rates and velocity confused": (
        lambda: flight(velocity=lambda v: driven(ROWS).body_rates),
        r"velocity",
    ),
    "a gyro that is dead": (
        lambda: flight(body_rates=signs(0, 0, 0)),
        r"body_rate_x, body_rate_y, body_rate_z never change in 900 rows",
    ),
    "one gyro that is dead": (
        lambda: flight(body_rates=signs(1, 0, 1)),
        r"body_rate never changes in y",
    ),
    "commands constant": (
        lambda: flight(command=lambda u: 0 * u + 0.6),
        r"command_1.* never change",
    ),
    "one row": (lambda: lines(lambda all_: all_[:6]), r"no usable flight.*1 rows dropped"),
    "all NaN": (
        lambda: flight(velocity=lambda v: v * np.nan),
        r"no usable flight.*900 rows dropped: not a finite number in velocity_x",
    ),
    "on the ground": (
        lambda: flight(position=lambda p: p * np.array([1, 1, 0], np.float32)),
        r"900 rows dropped: below 0\.1 m \(first: row 1\)",
    ),
    "motors off": (lambda: flight(command=lambda u: 0 * u), r"900 rows dropped: motors off"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_damaged_log_is_refused_by_its_name_and_reason(tmp_path, what):
    make, words = REFUSED[what]
    content = make()
    path = tmp_path / "bad.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError, match=words) as refused:
        read_flights(path)
    said = str(refused.value)
    assert "bad.csv" in said
    assert "\n" not in said
    assert len(said) < 700


def bad_rows(group: str, rows: slice, value: float):
    values = getattr(driven(ROWS), group).copy()
    values[rows, 0] = value
    return flight_csv.to_csv(replace(driven(ROWS), **{group: values}))


TOLD: dict[str, tuple[Callable[[], str | bytes], str, int]] = {
    "a last line that is cut": (
        lambda: good()[:-60],
        rf"1 row dropped: the last line \({FIRST + ROWS - 1}\) is cut off",
        ROWS - 1,
    ),
    "a line cut in the middle": (
        lambda: lines(lambda all_: all_.__setitem__(305, all_[305][:40])),
        r"1 rows dropped: not a finite",
        ROWS - 1,
    ),
    "missing rows": (
        lambda: lines(lambda all_: all_.__delitem__(slice(305, 325))),
        r"cut at a jump of time \(largest 0\.210 s .*row 301",
        880,
    ),
    "a huge number": (
        lambda: cell(300, "position_x", "1e300"),
        r"1 rows dropped: not a finite number in position_x \(first: row 300",
        899,
    ),
    "a tail of tumbling": (
        lambda: bad_rows("attitude", slice(800, None), 2.0),
        r"100 rows dropped: tilt above 60 deg \(first: row 801",
        800,
    ),
    "two flights glued": (
        lambda: lines(lambda all_: all_ + all_[5:]),
        r"cut at a jump of time \(largest -8\.990 s",
        2 * ROWS,
    ),
    "a jump of the estimate": (
        lambda: bad_rows("position", slice(450, None), 3.0),
        r"1 rows dropped: position jumps .*first: row 451",
        899,
    ),
    "a gap in one column": (
        lambda: bad_rows("command", slice(10, 20), np.nan),
        r"10 rows dropped: not a finite number in command_1",
        880,
    ),
}


@pytest.mark.parametrize("what", TOLD)
def test_damage_in_some_rows_costs_those_and_is_told(tmp_path, what):
    make, words, rows = TOLD[what]
    content = make()
    path = tmp_path / "bad.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    read = read_flights(path)
    assert sum(map(len, read)) == rows
    assert any(re.search(words, note) and "bad.csv" in note for note in read.notes), read.notes


def test_the_good_log_is_read_whole_and_without_notes(tmp_path):
    for name, content in (
        ("plain", good().encode()),
        ("bom", b"\xef\xbb\xbf" + good().encode()),
        ("crlf", good().replace("\n", "\r\n").encode()),
    ):
        (tmp_path / f"{name}.csv").write_bytes(content)
        read = read_flights(tmp_path / f"{name}.csv")
        assert ([len(piece) for piece in read], read.notes) == ([ROWS], ())


@pytest.mark.parametrize("seed", range(5))
def test_a_world_with_another_origin_is_no_contradiction(tmp_path, seed):
    made = driven(600, seed)
    made = replace(made, position=made.position + np.array([5, -3, 1], np.float32))
    flight_csv.write(tmp_path / "calm.csv", made)
    assert read_flights(tmp_path).notes == ()


def test_a_folder_with_bad_logs_still_gives_the_good_ones_and_says_so(tmp_path, capsys):
    flight_csv.write(tmp_path / "day" / "good.csv", driven(ROWS))
    flight_csv.write(tmp_path / "good.csv", driven(ROWS, seed=1))
    (tmp_path / "results.csv").write_text("policy,return\n1,2\n")
    for number, what in enumerate(REFUSED):
        content = REFUSED[what][0]()
        (tmp_path / f"bad_{number:02d}.csv").write_bytes(
            content if isinstance(content, bytes) else content.encode()
        )
    read = read_flights(tmp_path, faulty="skip")
    assert [len(piece) for piece in read] == [ROWS, ROWS]
    told = [said for said in (*read.refused, *read.notes) if "bad_" in said]
    assert all(any(f"bad_{number:02d}" in said for said in told) for number in range(len(REFUSED)))
    assert any("results.csv: not a flight log" in note for note in read.notes)

    content = logs_output.to_content(read)
    assert content["refused"] == read.refused
    assert content["pieces"] == 2
    lines = logs_output.describe_flights(read)
    assert f"{len(read.refused)} files refused:" in lines
    assert f"  {read.refused[0]}" in lines


def test_what_is_no_file_is_told_or_ignored(tmp_path):
    flight_csv.write(tmp_path / "folder.csv" / "good.csv", driven(ROWS))
    (tmp_path / "loop.csv").symlink_to(tmp_path / "loop.csv")
    (tmp_path / "round").symlink_to(tmp_path)
    (tmp_path / "picture.png").write_bytes(b"\x89PNG")
    os.mkfifo(tmp_path / "pipe.csv")
    read = read_flights(tmp_path)
    assert len(read) == 1
    assert [said.partition(": ")[2] for said in read.refused] == [
        "this link leads nowhere. Mend or remove it."
    ]


def test_a_folder_of_pictures_says_what_is_looked_for(tmp_path):
    (tmp_path / "picture.png").write_bytes(b"\x89PNG")
    with pytest.raises(
        InputError, match=r"no flight logs \(\.csv, \.csv\.gz, \.parquet, .*\).*maidenflight record"
    ):
        read_flights(tmp_path)


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may read everything")
def test_what_may_not_be_read_is_refused(tmp_path):
    flight_csv.write(tmp_path / "good.csv", driven(ROWS))
    flight_csv.write(tmp_path / "secret.csv", driven(ROWS)).chmod(0)
    assert "secret.csv: cannot be read" in read_flights(tmp_path).refused[0]


def test_a_file_that_cannot_be_opened_is_refused(tmp_path, monkeypatch):
    flight_csv.write(tmp_path / "good.csv", driven(ROWS))
    flight_csv.write(tmp_path / "secret.csv", driven(ROWS))
    whole = type(tmp_path).open

    def open_(path, *arguments, **options):
        if path.name == "secret.csv":
            raise PermissionError(13, "Permission denied")
        return whole(path, *arguments, **options)

    monkeypatch.setattr(type(tmp_path), "open", open_)
    (said,) = read_flights(tmp_path).refused
    assert "secret.csv: cannot be read as a flight log ([Errno 13] Permission denied)" in said
