"""Reading files and folders: every format is recognised, and whatever else lies there is an
InputError or ignored."""

import gzip
import warnings
from functools import cache

import numpy as np
import polars
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from made_flights import AUTHORS, authors_columns, authors_text, calm, driven, same
from maidenflight.errors import InputError
from maidenflight.flights import flight_csv
from maidenflight.flights.reading import Flights, read_flights


@cache
def ours(rows=80, seed=0):
    return flight_csv.to_csv(driven(rows=rows, seed=seed)).encode()


@cache
def theirs(rows=80):
    return authors_text(authors_columns(rows=rows)).encode()


def put(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("name", ["a.csv", "a.csv.gz"])
@pytest.mark.parametrize("content", [ours, theirs])
def test_one_file_of_either_format_is_read_plain_or_compressed(tmp_path, name, content):
    data = content()
    path = put(tmp_path / "day" / name, gzip.compress(data) if name.endswith("gz") else data)
    read = read_flights(path)
    assert (len(read), read.notes, read.paths) == (1, (), (path,))
    assert read.flights[0].name == f"day/{name}"
    assert read.duration == pytest.approx(0.8)
    assert same(read.flights[0], read_flights(put(tmp_path / "plain.csv", data)).flights[0])


def test_each_flight_is_told_of_before_the_next_file_is_read(tmp_path):
    for number in (1, 2):
        put(tmp_path / f"{number}.csv", ours(seed=number))
    events = []
    read_flights(
        tmp_path,
        on_file=lambda done, of: events.append(done),
        on_flight=lambda flight: events.append(flight.name),
    )
    assert [str(one)[-5:] for one in events] == ["1.csv", "1", "2.csv", "2"]


def test_the_authors_columns_are_read_from_parquet_too(tmp_path):
    plain = put(tmp_path / "plain.csv", theirs())
    polars.read_csv(plain).write_parquet(tmp_path / "same.parquet")
    assert same(read_flights(plain).flights[0], read_flights(tmp_path / "same.parquet").flights[0])


def test_more_columns_than_needed_are_no_harm(tmp_path):
    wide = tmp_path / "wide.csv"
    polars.read_csv(theirs()).with_columns(polars.lit("x").alias("remark")).write_csv(wide)
    assert len(read_flights(wide)) == 1


@pytest.mark.parametrize("step", [0.005, 0.02, 10.0])
def test_the_authors_columns_at_another_rate_are_refused(tmp_path, step):
    table = polars.read_csv(theirs(200)).with_columns(time=step * polars.arange(200))
    table.write_csv(tmp_path / "rate.csv")
    with pytest.raises(
        InputError,
        match=r"rate\.csv: .*(ms apart by column time|time runs backwards or leaps 199 times)",
    ):
        read_flights(tmp_path / "rate.csv")


def test_a_folder_is_searched_to_its_depth_in_the_order_of_names(tmp_path):
    put(tmp_path / "b" / "2.csv.gz", gzip.compress(ours(90)))
    put(tmp_path / "b" / "deep" / "er" / "1.csv", ours(100, 1))
    put(tmp_path / "a.csv", theirs(70))
    put(tmp_path / "b" / "notes.txt", b"no log")
    seen = []
    read = read_flights(tmp_path, lambda done, all_: seen.append((done, all_)))
    assert [len(flight) for flight in read] == [70, 90, 100]
    assert [path.name for path in read.paths] == ["a.csv", "2.csv.gz", "1.csv"]
    assert seen == [(1, 3), (2, 3), (3, 3)]


@pytest.mark.slow
def test_of_a_large_folder_stretches_of_every_flight_are_kept_whatever_the_order_on_disk(tmp_path):
    names = [f"{number}.csv" for number in range(6)]
    for folder, order in (("x", names), ("y", names[::-1])):
        for name in order:
            put(tmp_path / folder / "day" / name, ours(900, int(name[0])))
    one, other = (read_flights(tmp_path / folder, most=18.0) for folder in "xy")
    assert all(same(a, b) for a, b in zip(one, other, strict=True))
    assert {flight.name for flight in one} == {f"day/{name}" for name in names}
    assert len(one.paths) == 6
    assert 17.9 < one.duration < 18.1
    assert one.notes[0].startswith("18 of 54 s of flight used")
    everything = read_flights(tmp_path / "x", most=54.1)
    assert everything.notes == ()
    assert all(same(a, b) for a, b in zip(everything, read_flights(tmp_path / "x"), strict=True))


def test_a_battery_law_is_of_logs_that_hold_pwm(tmp_path):
    for name, data in (("ours", ours()), ("theirs", theirs())):
        path = put(tmp_path / name / "flight.csv", data)
        for place in (path, path.parent):
            with pytest.raises(InputError, match=r"flight\.csv"):
                read_flights(place, battery_law="legacy propellers")


OTHER_TABLES = {
    "rows": b"policy,return\n1,2\n",
    "empty": b"",
    "blank": b"\n\n",
    "packed": gzip.compress(b"policy,return\n1,2\n"),
}


@pytest.mark.parametrize("kind", OTHER_TABLES)
def test_other_tables_in_a_folder_are_ignored(tmp_path, kind):
    table = OTHER_TABLES[kind]
    put(tmp_path / "flight.csv", ours())
    put(tmp_path / ("results.csv.gz" if table[:2] == b"\x1f\x8b" else "results.csv"), table)
    read = read_flights(tmp_path)
    assert [path.name for path in read.paths] == ["flight.csv"]
    assert len([said for said in (*read.notes, *read.refused) if "results.csv" in said]) == 1, (
        "but not in silence"
    )


OWN_TABLES = {
    "training.csv": b"update,steps,policy,episode_return\n1,64,1,-3.0\n",
    "flights.csv": b"flight,policy,reality,trial,duration,end_reason,position_error,command_change,"
    b"at_limits\n1,1,virtual:1,1,20.0,time,0.1,0.01,0.0\n",
    "identification.csv": b"trial,thrust_to_weight,objective\n1,1.8,10.0\n",
    "validation.csv": b"# maidenflight validation 1: errors\n# record: "
    b"{}\nmodel,horizon,windows\nx,0.1,3\n",
}


@pytest.mark.parametrize("name", OWN_TABLES)
def test_our_own_result_tables_are_passed_over_in_silence(tmp_path, name):
    put(tmp_path / "flight.csv", ours())
    put(tmp_path / name, OWN_TABLES[name])
    read = read_flights(tmp_path)
    assert (len(read), read.notes, read.refused) == (1, (), ())


def test_a_log_with_its_columns_in_another_order_is_read_in_a_folder_too(tmp_path):
    columns, names = authors_columns(rows=80), AUTHORS.split(",")
    text = authors_text(columns[:, ::-1]).replace(AUTHORS, ",".join(names[::-1]))
    path = put(tmp_path / "reversed.csv", text.encode())
    assert len(read_flights(path)) == 1
    assert len(read_flights(tmp_path)) == 1


def test_a_flight_that_two_files_hold_is_used_once(tmp_path):
    flights = [calm(200, 1), calm(200, 2), calm(200, 1)]
    for number, flight in enumerate(flights):
        flight_csv.write(tmp_path / f"log_{number}.csv", flight, {"copy": number})
    read = read_flights(tmp_path)
    assert [path.name for path in read.paths] == ["log_0.csv", "log_1.csv"]
    assert len(read) == 2
    assert ["log_2" in note for note in read.notes] == [True]


def test_notes_of_all_files_are_kept(tmp_path):
    lines = ours(200).decode().split("\n")
    put(tmp_path / "gap.csv", "\n".join(lines[:100] + lines[120:]).encode())
    put(tmp_path / "short.csv", ours(40))
    read = read_flights(tmp_path)
    assert [len(flight) for flight in read] == [95, 85]
    assert len(read.notes) == 2
    assert "cut at a jump" in read.notes[0]
    assert "40 rows dropped" in read.notes[1]


REFUSED = {
    "an unknown format": (
        b"t,x,y\n1,2,3\n",
        "unknown format.*'t,x,y'.*maidenflight flight 3.*22 columns.*51 columns.*stateEstimate.x",
    ),
    "an empty file": (b"", "the file is empty"),
    "a truncated gzip": (gzip.compress(ours())[:-200], "cannot be read"),
    "a damaged gzip": (
        gzip.compress(ours())[:60] + b"\x00" * 40 + gzip.compress(ours())[100:],
        "cannot be read",
    ),
    "only the start of a gzip": (b"\x1f\x8b", "cannot be read"),
    "text that is not UTF-8": (ours().replace(b"subsampled", b"s\xffbsampled"), "cannot be read"),
    "too short a flight": (ours(49), "no usable flight in 1 files.*0.5 s"),
    "a column short": (ours().replace(b"command_4", b"command_5"), "missing column command_4"),
    "no rows": (b"\n".join(ours().split(b"\n")[:5]) + b"\n", "no rows"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_is_refused_in_words(tmp_path, what):
    content, words = REFUSED[what]
    with pytest.raises(InputError, match=words):
        read_flights(put(tmp_path / "bad.csv", content))


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_refused_alone_leaves_the_rest_of_its_folder(tmp_path, what):
    put(tmp_path / "good.csv", ours())
    put(tmp_path / "bad.csv", REFUSED[what][0])
    read = read_flights(tmp_path)
    assert len(read) == 1
    assert len([said for said in (*read.refused, *read.notes) if "bad.csv" in said]) == 1


@pytest.mark.parametrize("what", ["a truncated gzip", "a damaged gzip", "only the start of a gzip"])
def test_a_folder_of_nothing_but_damage_is_refused_with_the_reasons(tmp_path, what):
    for number in range(5):
        put(tmp_path / f"broken_{number}.csv.gz", REFUSED[what][0])
    with pytest.raises(
        InputError, match=r"no usable flight.*broken_0\.csv\.gz.*broken_2.*and 2 more"
    ):
        read_flights(tmp_path)


@pytest.mark.parametrize("make", [lambda path: path / "nowhere", lambda path: path])
def test_where_there_is_nothing_the_message_says_what_to_give(tmp_path, make):
    with pytest.raises(InputError, match=r"\.csv, \.csv\.gz"):
        read_flights(make(tmp_path))


def reads_or_refuses(path):
    """The law of all garbage; that NumPy warns of numbers too large for float32 is another test's
    matter."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            read = read_flights(path)
    except InputError:
        return
    assert isinstance(read, Flights)
    for flight in read:
        assert len(flight) >= 50
        assert all(
            np.isfinite(getattr(flight, group)).all()
            for group in ("position", "velocity", "attitude", "body_rates", "command")
        )


@pytest.mark.parametrize("cell", [b"inf", b"-1e39"])
@pytest.mark.parametrize(
    ("source", "column"),
    [(ours, 1), (ours, 14), (ours, 17), (theirs, 0), (theirs, 13), (theirs, 17), (theirs, 20)],
)
def test_a_number_without_measure_costs_at_most_its_row_and_no_warning(
    tmp_path, source, column, cell
):
    """Columns: position, command and battery of our own log; x, n1, mot1 and battery of the
    authors'."""
    lines = source(200).split(b"\n")
    line = lines[-51].split(b",")
    lines[-51] = b",".join([*line[:column], cell, *line[column + 1 :]])
    read = read_flights(put(tmp_path / "x.csv", b"\n".join(lines)))
    assert 149 <= sum(map(len, read)) <= 200
    assert all(np.isfinite(flight.command).all() for flight in read)


def test_a_file_saved_on_windows_is_read_alike(tmp_path):
    plain, windows = (
        put(tmp_path / "x" / "1.csv", ours()),
        put(tmp_path / "y" / "1.csv", ours().replace(b"\n", b"\r\n")),
    )
    assert same(read_flights(windows).flights[0], read_flights(plain).flights[0])


HEADS = [
    b"",
    flight_csv.MARK.encode() + b"\n",
    flight_csv.MARK.encode() + b"\n# commands: zero-order-hold\n",
    AUTHORS.encode() + b"\n",
    b"\x1f\x8b\x08\x00",
    b"PAR1",
]


@settings(max_examples=200)
@given(head=st.sampled_from(HEADS), body=st.binary(max_size=200))
def test_random_bytes_are_refused_not_crashed_on(tmp_path_factory, head, body):
    for name in ("fuzz.csv", "fuzz.csv.gz", "fuzz.parquet"):
        reads_or_refuses(put(tmp_path_factory.getbasetemp() / "random" / name, head + body))
    reads_or_refuses(tmp_path_factory.getbasetemp() / "random")


CELLS = [
    b"inf",
    b"-inf",
    b"nan",
    b"1e300",
    b"-1e39",
    b"",
    b"true",
    b"2020-01-01",
    b'"',
    b",",
    b"\n",
    b"\x00",
    b"9" * 40,
    b"#",
    b"\r",
    b"-",
]


@settings(max_examples=200)
@given(
    source=st.sampled_from([ours, theirs]),
    edits=st.lists(
        st.tuples(
            st.floats(0, 1), st.integers(0, 400), st.sampled_from(CELLS) | st.binary(max_size=6)
        ),
        min_size=1,
        max_size=4,
    ),
    zipped=st.booleans(),
)
def test_damaged_logs_are_read_or_refused_not_crashed_on(tmp_path_factory, source, edits, zipped):
    content = source()
    for place, length, new in edits:
        start = int(place * len(content))
        content = content[:start] + new + content[start + length :]
    reads_or_refuses(
        put(
            tmp_path_factory.getbasetemp() / "damaged" / "x.csv",
            gzip.compress(content, 1) if zipped else content,
        )
    )


@settings(max_examples=100)
@given(
    source=st.sampled_from([ours, theirs]),
    cells=st.lists(
        st.tuples(st.integers(0, 79), st.integers(0, 20), st.sampled_from(CELLS)),
        min_size=1,
        max_size=5,
    ),
)
def test_strange_cells_are_read_or_refused_not_crashed_on(tmp_path_factory, source, cells):
    lines = source().split(b"\n")
    for row, column, new in cells:
        line = lines[-81 + row].split(b",")
        lines[-81 + row] = b",".join([*line[:column], new, *line[column + 1 :]])
    reads_or_refuses(put(tmp_path_factory.getbasetemp() / "cells" / "x.csv", b"\n".join(lines)))
