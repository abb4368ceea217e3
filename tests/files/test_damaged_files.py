"""Damaged files of every kind are refused in one line, or mean what they meant.

A night's run: make night.
"""

import os
import tempfile
import warnings
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from damage import PREFIX, REFUSED, SAME, TOLD, Damaged
from file_kinds import POLICY, Kind, known_kinds, lay
from maidenflight import inputs
from maidenflight.errors import LONGEST, InputError
from maidenflight.flights.streams.streams import period

NAMES = (
    *("log of ours", "log of authors", "log of nanobench", "log of cflib", "log.csv.gz"),
    *("log.parquet", "log.ulg", "log.bin", "log.bbl", "log of a card", "log.mcap", "log.db3"),
    *("log of other columns", "map of columns", "folder of logs", "drone"),
    *("drone with a posterior", "policy", "policy of the authors", "study", "way-points"),
    *("rows of a real flight", "checkpoint", "record in a table", "run folder"),
    "page of a run folder",
)


@pytest.fixture(scope="module", autouse=True)
def kinds() -> None:
    """Makes the good files, by modules whose own examples hypothesis lets no example make."""
    known_kinds()


@cache
def read_good(name: str, number: int) -> Any:
    """What is understood of a good file."""
    kind = known_kinds()[name]
    return read(kind, number, kind.good[number].content)


def read(kind: Kind, number: int, content: bytes) -> Any:
    with tempfile.TemporaryDirectory() as folder:
        place = kind.good[number].place
        lay(Path(folder), {**kind.around, place: content})
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            return kind.read(Path(folder), Path(folder, place))


def is_equal(one: np.ndarray, other: np.ndarray) -> bool:
    return one.shape == other.shape and np.array_equal(one, other, equal_nan=one.dtype.kind == "f")


def misread(kind: Kind, before: Any, value: Any, verdict: str) -> str:
    """What a reader made of a file that it should not have made of it; see `damage`."""
    if kind.lenient:
        return ""
    old, new = kind.arrays(before), kind.arrays(value)
    if verdict == REFUSED:
        return "not refused"
    if verdict == SAME:
        same = len(old) == len(new) and all(map(is_equal, old, new))
        return "" if same else "other than before"
    if verdict == PREFIX:
        begins = zip(old[3:4], new[3:4], strict=True)
        cut = all(is_equal(one[: len(other)], other) for one, other in begins)
        return "" if cut else "no beginning of what was before"
    is_silent = len(kind.notes(value)) <= len(kind.notes(before))
    lost = verdict == TOLD and new and len(new[0]) < len(old[0]) and is_silent
    return "rows lost without a word" if lost else ""


def judge(name: str, number: int, damaged: Damaged) -> None:
    """Fails unless a damaged file is refused in a line, or accepted for what it may mean."""
    kind = known_kinds()[name]
    try:
        value = read(kind, number, damaged.content)
    except InputError as error:
        text = str(error)
        assert "\n" not in text
        assert len(text) <= LONGEST
        return
    assert kind.fault(value) == "", damaged.what
    assert misread(kind, read_good(name, number), value, damaged.verdict) == "", damaged.what


def test_kinds_are_all_of_them() -> None:
    assert tuple(known_kinds()) == NAMES


# A file that pymavlink could not read is closed by the garbage collector.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@settings(suppress_health_check=(HealthCheck.too_slow, HealthCheck.large_base_example))
@given(data=st.data())
def test_damaged_files_are_refused_or_mean_what_they_meant(name: str, data: Any) -> None:
    good = known_kinds()[name].good
    number = data.draw(st.integers(0, len(good) - 1))
    other = data.draw(st.sampled_from(good))
    judge(name, number, data.draw(good[number].damage(good[number].content, other.content)))


@pytest.mark.parametrize(
    ("name", "row", "cells"),
    [("log of cflib", 1, ""), ("log of ours", 6, "inf,inf"), ("log of cflib", 1, "5010.0")],
)
def test_rows_that_a_night_found_raise_no_warning(name: str, row: int, cells: str) -> None:
    lines = known_kinds()[name].good[0].content.decode().split("\n")
    rest = lines[row].split(",")[cells.count(",") + bool(cells) :] if cells else []
    lines[row] = ",".join([*([cells] if cells else []), *rest])
    judge(name, 0, Damaged("\n".join(lines).encode(), "a row", "any"))


def test_a_period_of_steps_that_are_all_far_from_their_median() -> None:
    assert period(np.array([0.0, 0.0, 0.01])) == 0.005


@pytest.mark.parametrize("name", NAMES)
def test_good_files_are_accepted_and_sound(name: str) -> None:
    kind = known_kinds()[name]
    for number in range(len(kind.good)):
        assert kind.fault(read_good(name, number)) == ""


SPECIAL = ("folder", "pipe", "link to itself", "link to nothing", "link to a device", "link")


@pytest.mark.parametrize("what", SPECIAL)
@pytest.mark.parametrize("name", ["policy", "checkpoint", "log of ours", "way-points", "study"])
def test_what_is_no_file_is_refused_and_not_waited_for(
    name: str, what: str, tmp_path: Path
) -> None:
    kind = known_kinds()[name]
    place = tmp_path / kind.good[0].place
    target = {"link to itself": place, "link to a device": Path("/dev/zero")}
    if what == "folder":
        place.mkdir()
    elif what == "pipe":
        os.mkfifo(place)
    else:
        place.symlink_to(target.get(what, tmp_path / "beside.bin"))
    if what == "link":
        (tmp_path / "beside.bin").write_bytes(kind.good[0].content)
        value = kind.read(tmp_path, place)
        assert misread(kind, read_good(name, 0), value, SAME) == ""
    else:
        with pytest.raises(InputError):
            kind.read(tmp_path, place)


def believes_all(folder: Path, path: Path) -> Any:
    try:
        return POLICY.read(folder, path)
    except InputError:
        return read_good("policy", 0)


def refuses_in_lines(folder: Path, path: Path) -> Any:
    class Long(InputError):
        def __str__(self) -> str:
            return "one\ntwo"

    raise Long("")


@pytest.mark.parametrize(
    ("wrong", "error"),
    [
        (lambda *_: 1 / 0, ZeroDivisionError),
        (lambda *_: warnings.warn("of NumPy", stacklevel=1), UserWarning),
        (believes_all, AssertionError),
        (refuses_in_lines, AssertionError),
    ],
)
def test_a_reader_that_fails_warns_believes_all_or_says_too_much_is_noticed(
    wrong: Any, error: type[Exception], monkeypatch: pytest.MonkeyPatch
) -> None:
    read_good("policy", 0)
    monkeypatch.setitem(known_kinds(), "policy", known_kinds()["policy"]._replace(read=wrong))
    with pytest.raises(error):
        judge("policy", 0, Damaged(b"{}", "all lost", REFUSED))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('{"a": 1, "a": 2}', "'a'"),
        ('[{"b": {"c": 1, "c": 1}}]', "'c'"),
        ("[" * 100_000, "too deep"),
    ],
    ids=["twice", "twice below", "deep"],
)
def test_json_says_everything_once_and_ends(text: str, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        inputs.from_json(text)


def test_an_error_is_one_line_of_bounded_length() -> None:
    said = str(InputError("here: " + "x\n" * 10_000 + "Mend it."))
    assert "\n" not in said
    assert len(said) <= LONGEST
    assert said.startswith("here: x")
    assert said.endswith("Mend it.")
