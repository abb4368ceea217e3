"""Long files are read in parts: they hold the same rows, and are judged as a whole."""

import gzip

import numpy as np
import polars
import pytest

from made_flights import driven
from maidenflight.errors import InputError
from maidenflight.flights import flight_csv, tables
from maidenflight.flights.checkup.result import (
    FAILS,
    PASSES,
    UNKNOWN,
    WARNS,
    CheckResult,
    typical_results,
)
from maidenflight.flights.reading import read_flights


def rows(flights):
    """All rows of body rates and commands."""
    return np.concatenate([np.hstack([one.body_rates, one.command]) for one in flights])


@pytest.fixture
def parts(monkeypatch):
    monkeypatch.setattr(tables, "PART", 30_000)
    monkeypatch.setattr(tables, "PART_ROWS", 200)


@pytest.mark.parametrize("kind", ["csv", "csv.gz", "parquet"])
def test_a_long_file_in_parts_holds_the_rows_of_the_whole(tmp_path, monkeypatch, kind):
    path = tmp_path / f"long.{kind}"
    text = flight_csv.to_csv(driven(900))
    if kind == "parquet":
        table = tables.from_text(text, "long")
        table.frame.write_parquet(path, metadata=table.head)
    else:
        path.write_bytes(gzip.compress(text.encode(), 0) if kind == "csv.gz" else text.encode())
    whole = read_flights(path, faulty="use")
    monkeypatch.setattr(tables, "PART", 30_000)
    monkeypatch.setattr(tables, "PART_ROWS", 200)
    several = read_flights(path, faulty="use")
    assert len(several) > len(whole)
    assert several.duration == pytest.approx(whole.duration, abs=0.011 * len(several))
    np.testing.assert_array_equal(rows(several), rows(whole))


@pytest.mark.parametrize("fault", [",x", ",\xe9"])
def test_a_fault_deep_in_a_long_file_is_named_by_its_line(tmp_path, parts, fault):
    lines = flight_csv.to_csv(driven(900)).splitlines()
    lines[800] = lines[800].replace(",", fault, 1)
    path = tmp_path / "long.csv"
    path.write_text("\n".join([*lines, ""]), encoding="latin-1")
    with pytest.raises(InputError, match="line 801") as refused:
        read_flights(path)
    assert str(refused.value).count("cannot be read") < 2


def test_a_last_line_that_is_cut_off_is_dropped_of_a_long_file_too(tmp_path, parts):
    text = flight_csv.to_csv(driven(900))
    path = tmp_path / "long.csv"
    path.write_text(text[:-7])
    flights = read_flights(path, faulty="use")
    assert len(rows(flights)) == 899
    assert any("cut off" in note for note in flights.notes)


def test_a_table_of_numpy_keeps_its_names_in_every_part(tmp_path, parts):
    frame = tables.from_text(flight_csv.to_csv(driven(900)), "p").frame
    path = tmp_path / "long.csv"
    np.savetxt(path, frame.to_numpy(), delimiter=",", header=",".join(frame.columns))
    several = list(tables.parts(path, "long"))
    assert len(several) > 2
    for one in several:
        assert one.frame.columns == frame.columns
    joined = polars.concat(one.frame for one in several)
    np.testing.assert_allclose(joined.to_numpy(), frame.to_numpy())


@pytest.mark.parametrize(
    ("verdicts", "together"),
    [
        ((PASSES, PASSES, FAILS), PASSES),
        ((PASSES, FAILS, FAILS), FAILS),
        ((UNKNOWN, UNKNOWN, WARNS), WARNS),
        ((UNKNOWN, UNKNOWN), UNKNOWN),
    ],
)
def test_parts_conclude_by_the_median_of_those_that_can_tell(verdicts, together):
    results = [(CheckResult("axes", verdict, ""),) for verdict in verdicts]
    assert [one.verdict for one in typical_results(results)] == [together]
