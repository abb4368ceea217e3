"""Our own log format: what is written is read back, and what is not a log is refused in words."""

import io
import json
import re
from dataclasses import replace

import numpy as np
import polars
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from made_flights import calm
from maidenflight.errors import InputError
from maidenflight.flights import flight_csv, log, tables
from maidenflight.flights.reading import read_flights
from pages import run_python


def numbers(rows, columns=None):
    elements = st.floats(-100, 100, width=32)
    return arrays(np.float32, rows if columns is None else (rows, columns), elements=elements)


@st.composite
def flights(draw):
    rows = draw(st.integers(2, 12))
    groups = {"position": 3, "velocity": 3, "attitude": 3, "body_rates": 3, "command": 4}
    unknown = st.just(np.float32("nan"))
    return log.Flight(
        name="made",
        period=draw(st.sampled_from([0.001, 0.002, 0.005, 0.01, 0.02, 1 / 30])),
        **{group: draw(numbers(rows, columns)) for group, columns in groups.items()},
        battery=draw(arrays(np.float32, rows, elements=st.floats(0, 10, width=32) | unknown)),
        setpoint=draw(
            arrays(np.float32, (rows, 3), elements=st.floats(-10, 10, width=32) | unknown)
        ),
        zero_order_hold=draw(st.booleans()),
        simulated=draw(st.sampled_from(["", "virtual:3", "a: b"])),
    )


@given(flights())
def test_a_written_flight_is_read_back_to_a_millionth(flight):
    again = flight_csv.from_csv(flight_csv.to_csv(flight), "made")
    assert (again.zero_order_hold, again.simulated, again.name, len(again)) == (
        flight.zero_order_hold,
        flight.simulated,
        "made",
        len(flight),
    )
    assert again.period == pytest.approx(flight.period, abs=1e-6)
    for group in (
        "position",
        "velocity",
        "attitude",
        "body_rates",
        "command",
        "battery",
        "setpoint",
    ):
        before, after = getattr(flight, group), getattr(again, group)
        assert after.dtype == np.float32
        np.testing.assert_allclose(after, before, rtol=0, atol=1e-6, equal_nan=True)


def test_a_battery_and_a_setpoint_that_nobody_knows_survive():
    unknown = calm(
        battery=np.full(120, np.nan, np.float32), setpoint=np.full((120, 3), np.nan, np.float32)
    )
    again = flight_csv.from_csv(flight_csv.to_csv(unknown), "made")
    assert np.isnan(again.battery).all()
    assert np.isnan(again.setpoint).all()
    assert not np.isnan(again.position).any()


def test_a_flight_of_one_row_is_read():
    again = flight_csv.from_csv(flight_csv.to_csv(calm(rows=1)), "made")
    assert len(again) == 1


def test_a_held_command_is_its_own_mean():
    flight = calm(zero_order_hold=True)
    np.testing.assert_array_equal(flight.mean_command, flight.command)


def test_a_sampled_command_is_averaged_with_the_next_one():
    flight = calm(zero_order_hold=False)
    np.testing.assert_allclose(
        flight.mean_command[:-1], (flight.command[:-1] + flight.command[1:]) / 2
    )
    np.testing.assert_array_equal(flight.mean_command[-1], flight.command[-1])


def test_rotors_are_to_turn_with_the_root_of_the_mean_command():
    flight = calm(zero_order_hold=False)
    over = replace(flight, command=flight.command - flight.command[0])
    assert flight.speed_command.dtype == np.float64
    np.testing.assert_allclose(flight.speed_command**2, flight.mean_command, rtol=1e-6)
    assert (over.mean_command < 0).any()
    assert over.speed_command.min() == 0.0


def test_duration_is_rows_times_period():
    assert calm(rows=150).duration == pytest.approx(1.5)


def test_a_file_says_what_it_is_and_in_which_units():
    lines = flight_csv.to_csv(
        calm(zero_order_hold=False, simulated="virtual:3"), {"seed": 7}
    ).split("\n")
    assert lines[0].startswith(flight_csv.MARK)
    for quantity in (
        "time s;",
        "position m ",
        "velocity m/s ",
        "yaw rad ",
        "body_rate rad/s,",
        "thrust u from 0",
        "battery V;",
        "setpoint m$",
    ):
        assert re.search(quantity, lines[0]), quantity
    assert lines[1:3] == ["# commands: subsampled", "# simulated: virtual:3"]
    assert json.loads(lines[3].removeprefix("# record: ")) == {"seed": 7}
    assert lines[4].split(",") == [column for group in log.GROUPS.values() for column in group]
    assert len(lines) == 5 + 120 + 1


def test_the_same_flight_makes_the_same_bytes(tmp_path):
    paths = [
        flight_csv.write(tmp_path / name, calm(), {"b": 1, "a": 2})
        for name in ("one.csv", "two.csv")
    ]
    assert (
        paths[0].read_bytes()
        == paths[1].read_bytes()
        == flight_csv.to_csv(calm(), {"b": 1, "a": 2}).encode()
    )


@pytest.mark.parametrize(
    "column", ["time", "position_x", "roll", "body_rate_z", "command_4", "battery", "setpoint_y"]
)
def test_a_missing_column_is_named(column):
    with pytest.raises(InputError, match=rf"x\.csv: missing column {column};"):
        flight_csv.from_csv(flight_csv.to_csv(calm()).replace(column, "something_else"), "x.csv")


def test_text_in_a_numeric_column_is_named():
    lines = flight_csv.to_csv(calm()).split("\n")
    lines[9] = lines[9].replace(lines[9].split(",")[2], "left", 1)
    with pytest.raises(InputError, match=r"x\.csv: column position_y .*not a number") as told:
        flight_csv.from_csv("\n".join(lines), "x.csv")
    assert "'left'" in str(told.value)


def test_a_file_without_rows_is_refused():
    with pytest.raises(InputError, match=r"x\.csv: no rows"):
        flight_csv.from_csv("\n".join(flight_csv.to_csv(calm()).split("\n")[:5]) + "\n", "x.csv")


@pytest.mark.parametrize("line", ["", "# commands: often\n"])
def test_commands_must_be_held_or_sampled(line):
    with pytest.raises(
        InputError, match="'# commands: zero-order-hold' or '# commands: subsampled'"
    ):
        flight_csv.from_csv(
            flight_csv.to_csv(calm()).replace("# commands: zero-order-hold\n", line), "x.csv"
        )


@pytest.mark.parametrize(
    "text",
    ["", "\n", "\x00\x01\x02", "a" * 1000, "a,b\n1\n2,3,4\n", '"', "# commands: zero-order-hold"],
)
def test_what_is_no_table_is_refused(text):
    with pytest.raises(InputError, match=r"x\.csv"):
        flight_csv.from_csv(text, "x.csv")
    with pytest.raises(InputError, match=r"x\.csv"):
        tables.numbers(tables.from_text(text, "x.csv"), ["time"])


def to_parquet(path, flight, **metadata):
    """A flight in our columns as Parquet."""
    text = flight_csv.to_csv(flight)
    polars.read_csv(io.StringIO(text), comment_prefix="#").write_parquet(
        path, metadata=metadata or None
    )


def test_the_same_columns_are_read_from_parquet(tmp_path):
    to_parquet(
        tmp_path / "flight.parquet",
        calm(simulated="virtual:3"),
        commands="zero-order-hold",
        simulated="virtual:3",
    )
    read = read_flights(tmp_path)
    assert read.notes == ()
    (flight,) = read.flights
    assert (flight.zero_order_hold, flight.simulated) == (True, "virtual:3")
    np.testing.assert_allclose(flight.body_rates, calm().body_rates, atol=1e-6)


def test_parquet_too_must_say_what_a_command_is(tmp_path):
    to_parquet(tmp_path / "flight.parquet", calm())
    with pytest.raises(
        InputError, match=r"metadata lack 'commands: zero-order-hold' or 'commands: subsampled'"
    ):
        read_flights(tmp_path / "flight.parquet")


@pytest.mark.parametrize(
    "content",
    [b"PAR1", b"PAR1" + b"x" * 100 + b"PAR1", b"PAR1" + bytes(range(256)) * 9, b"a,b\n1,2\n", b""],
)
def test_parquet_that_is_none_is_refused(tmp_path, content):
    (tmp_path / "flight.parquet").write_bytes(content)
    with pytest.raises(InputError, match=r"flight\.parquet: not a"):
        read_flights(tmp_path / "flight.parquet")


def test_a_column_of_dates_in_parquet_is_named(tmp_path):
    text = flight_csv.to_csv(calm())
    frame = polars.read_csv(io.StringIO(text), comment_prefix="#")
    when = polars.datetime_range(
        polars.datetime(2024, 1, 1), polars.datetime(2024, 1, 2), "12m", eager=True
    )[:120]
    frame.with_columns(time=when).write_parquet(
        tmp_path / "flight.parquet", metadata={"commands": "zero-order-hold"}
    )
    with pytest.raises(InputError, match=r"column time holds Datetime.*not a number"):
        read_flights(tmp_path / "flight.parquet")


@pytest.mark.slow
def test_the_python_of_the_log_format_page_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run_python("docs/flight-log.md")
    assert (
        "2 pieces, 8.0 s\n()\n('logs/damaged.csv: columns are separated by semicolons in line 1"
        in capsys.readouterr().out
    )


@pytest.mark.parametrize("every", [1, 2, 5])
def test_averaged_rows_keep_the_state_and_the_mean_rotor_speed_of_their_commands(every):
    flight = calm(rows=203)
    slow = log.averaged(flight, every)
    count = 203 // every
    assert (len(slow), slow.period, slow.zero_order_hold) == (count, 0.01 * every, True)
    np.testing.assert_array_equal(slow.position, flight.position[: count * every : every])
    speeds = np.sqrt(flight.command[: count * every]).reshape(count, every, 4)
    np.testing.assert_allclose(np.sqrt(slow.command), speeds.mean(axis=1), rtol=1e-5)


@pytest.mark.parametrize("by_law", [True, False])
def test_a_log_says_whether_a_battery_law_made_its_commands(by_law):
    flight = replace(calm(), by_battery_law=by_law)
    assert flight_csv.from_csv(flight_csv.to_csv(flight), "one").by_battery_law is by_law
