"""What a report is made of: files and folders of any name, known by what they hold."""

import shutil
from pathlib import Path

import jax
import polars
import pytest
from test_page import RECORD, circling, errors, windows
from test_page import run as _run

from flights.made_flights import authors_columns, authors_text
from maidenflight import policy, policy_file, results, run_folder
from maidenflight.errors import InputError
from maidenflight.flights import log
from maidenflight.reporting import run as runs
from maidenflight.reporting import sources
from maidenflight.reporting.sources import kind_of
from maidenflight.simulator.policy_spec import PolicySpec

run = _run


def written(path: Path, table: run_folder.Table, rows: polars.DataFrame) -> Path:
    return table.write(path, rows, RECORD)


@pytest.fixture
def mine(run: Path, tmp_path: Path) -> Path:
    """The same files under names of one's own."""
    folder = tmp_path / "mine"
    folder.mkdir()
    shutil.copy(run / "drone.toml", folder / "my_drone.toml")
    shutil.copy(run / "reality.toml", folder / "truth of it.toml")
    shutil.copy(run / "identification.csv", folder / "my_drone_identification.csv")
    policy_file.write(
        folder / "my policies" / "a.json",
        policy.untrained(jax.random.key(0), spec=PolicySpec(hidden=(4,))),
    )
    shutil.copy(run / "policies" / "training.csv", folder / "my policies" / "scores.csv")
    written(folder / "predicted.csv", run_folder.VALIDATION, errors())
    written(folder / "predicted_windows.csv", run_folder.WINDOWS, windows())
    shutil.copytree(run / "recorded", folder / "logs of may")
    shutil.copytree(run / "transfer", folder / "flown")
    return folder


KINDS: dict[str, str | None] = {
    "my_drone.toml": "drone",
    "truth of it.toml": "truth",
    "my_drone_identification.csv": "evaluations",
    "my policies/a.json": "policies",
    "my policies/scores.csv": "training",
    "predicted.csv": "validation",
    "predicted_windows.csv": "windows",
    "logs of may/flight_01.csv": "logs",
    "flown/flights.csv": "table",
}


def test_a_file_is_known_by_what_it_holds(mine: Path) -> None:
    assert {name: kind_of(mine / name) for name in KINDS} == KINDS
    (mine / "notes.toml").write_text("mass = 3\n")
    (mine / "odd.json").write_text("[1]")
    (mine / "thesis.pdf").write_bytes(b"%PDF")
    for name in ("notes.toml", "odd.json", "thesis.pdf"):
        assert kind_of(mine / name) is None


def test_the_same_files_of_other_names_make_the_same_run(run: Path, mine: Path) -> None:
    given = ["my_drone.toml", "truth of it.toml", "my policies", "predicted.csv", "logs of may"]
    found = runs.read(*(mine / name for name in [*given, "flown"]))
    usual = runs.read(run)
    assert (found.estimates.keys(), found.policies, found.logs) == (
        usual.estimates.keys(),
        usual.policies,
        usual.logs,
    )
    for part in ("search", "validation", "windows", "training", "table"):
        one, other = getattr(found, part), getattr(usual, part)
        assert one is not None, part
        assert one.select(other.columns).equals(other), part
    assert len(found.flights) == len(usual.flights)
    assert found.reality is not None


def test_what_is_alone_of_its_kind_needs_no_name(mine: Path) -> None:
    found = sources.find([mine])
    assert found.drone == mine / "my_drone.toml"
    assert found.evaluations == mine / "my_drone_identification.csv"
    assert found.windows == mine / "predicted_windows.csv"
    assert set(found.others) == {"policies", "flight logs", "test flights"}


def test_a_file_comes_before_one_of_a_folder_and_two_are_refused(run: Path, mine: Path) -> None:
    assert sources.find([run, mine / "my_drone.toml"]).drone == mine / "my_drone.toml"
    for two in ([run, mine], [run / "drone.toml", mine / "my_drone.toml"]):
        with pytest.raises(InputError, match="of which a report shows one"):
            sources.find(two)


@pytest.mark.parametrize("name", ["nowhere", "notes.txt"])
def test_what_is_not_there_or_nothing_known_is_refused(name: str, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(InputError, match=r"expected|Give"):
        sources.find([tmp_path / name])


def test_a_folder_of_logs_is_searched_as_identify_does(tmp_path: Path) -> None:
    log.write(tmp_path / "deep" / "er" / "monday.csv", circling(1.0, simulated=""))
    log.write(tmp_path / "deep" / "tuesday.csv", circling(1.0, simulated=""))
    for name in ("flight_10", "flight_9"):
        text = authors_text(authors_columns(120))
        results.write(tmp_path / "theirs" / f"{name}.csv", text)
    results.write(tmp_path / "deep" / "other.csv", "a,b\n1,2\n")
    found = runs.read(tmp_path)
    assert [flight.name for flight in found.recorded] == [
        "er/monday.csv",
        "deep/tuesday.csv",
        "theirs/flight_9.csv",
        "theirs/flight_10.csv",
    ]
    assert (found.logs, len(found.refused)) == (4, 1)
    assert "other.csv" in found.refused[0]


def test_logs_of_any_format_beside_a_drone_are_shown(run: Path, tmp_path: Path) -> None:
    (tmp_path / "flown").mkdir()
    shutil.copy(run / "drone.toml", tmp_path / "flown")
    results.write(tmp_path / "flown" / "monday.csv", authors_text(authors_columns(120)))
    found = runs.read(tmp_path / "flown")
    assert [flight.name for flight in found.recorded] == ["flown/monday.csv"]
    results.write(tmp_path / "flown" / "monday.csv", "a,b\n1,2\n")
    with pytest.raises(InputError, match=r"monday\.csv"):
        runs.read(tmp_path / "flown" / "monday.csv")


def test_real_flights_in_the_authors_format_are_shown(shared_data: Path) -> None:
    found = runs.read(shared_data / "authors" / "flights" / "attitude" / "policy_118")
    assert len(found.recorded) == found.logs > 0
    assert not any(flight.simulated for flight in found.recorded)
    assert runs.viewable(found) == list(range(len(found.recorded)))
