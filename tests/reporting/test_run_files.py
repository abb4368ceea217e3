"""What a report is made of: the files that run.json lists, and those that a user gives."""

import shutil
from pathlib import Path

import jax
import polars
import pytest
from test_page import RECORD, circling, errors, page, windows
from test_page import run as _run

from made_flights import authors_columns, authors_text
from maidenflight import manifest, policy, policy_file, results, run_folder
from maidenflight.errors import InputError
from maidenflight.flights import flight_csv
from maidenflight.reporting import run as runs
from maidenflight.reporting.page import report
from maidenflight.reporting.run import Run
from maidenflight.reporting.run_files import FileOptions, find_files
from maidenflight.simulator.policy_spec import PolicySpec

run = _run


def written(path: Path, table: run_folder.Table, rows: polars.DataFrame) -> Path:
    return table.write(path, rows, RECORD)


@pytest.fixture
def mine(run: Path, tmp_path: Path) -> Path:
    """The same files under names of one's own, without run.json."""
    folder = tmp_path / "mine"
    folder.mkdir()
    shutil.copy(run / "drone.toml", folder / "my_drone.toml")
    shutil.copy(run / "reality.toml", folder / "truth of it.toml")
    policy_file.write_policy(
        folder / "my policies" / "a.json",
        policy.untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(4,))),
    )
    shutil.copy(run / "policies" / "training.csv", folder / "my policies")
    written(folder / "predicted.csv", run_folder.VALIDATION, errors())
    written(folder / "predicted_windows.csv", run_folder.WINDOWS, windows())
    shutil.copytree(run / "recorded", folder / "logs of may")
    shutil.copytree(run / "transfer", folder / "flown")
    return folder


def options(mine: Path) -> FileOptions:
    return {
        "drone": mine / "my_drone.toml",
        "truth": mine / "truth of it.toml",
        "policies": mine / "my policies",
        "validation": mine / "predicted.csv",
        "logs": mine / "logs of may",
        "flights": mine / "flown" / "flights.csv",
    }


def assert_alike(found: Run, usual: Run) -> None:
    assert (found.estimates.keys(), found.policies, found.logs) == (
        usual.estimates.keys(),
        usual.policies,
        usual.logs,
    )
    for part in ("validation", "windows", "training", "table"):
        one, other = getattr(found, part), getattr(usual, part)
        assert one is not None, part
        assert one.select(other.columns).equals(other), part
    assert len(found.flights) == len(usual.flights)
    assert found.reality is not None


def test_the_same_files_of_other_names_make_the_same_run(run: Path, mine: Path) -> None:
    assert_alike(runs.read_run(None, options(mine)), runs.read_run(run))


def test_a_run_folder_that_was_moved_is_read(run: Path, tmp_path: Path) -> None:
    usual = runs.read_run(run)
    run.rename(tmp_path / "moved")
    assert_alike(runs.read_run(tmp_path / "moved"), usual)
    assert runs.read_run(tmp_path / "moved").missing_files == []


def test_a_file_of_a_user_comes_before_that_of_the_run(run: Path, mine: Path) -> None:
    found = find_files(run, {"drone": mine / "my_drone.toml", "logs": [mine / "logs of may"]})
    assert found.first("drone") == mine / "my_drone.toml"
    assert found.files["logs"] == [mine / "logs of may" / "flight_01.csv"]
    assert found.files["truth"] == []
    assert found.first("validation") == run / "validation.csv"
    assert found.others == {"identified drones": ["drone.toml"], "flight logs": ["recorded/"]}


def test_a_renamed_file_is_missed_and_shown_by_its_option(run: Path, tmp_path: Path) -> None:
    (run / "drone.toml").rename(run / "my_drone.toml")
    content = page(run, tmp_path)
    assert 'class="sortable estimates"' not in content
    assert "no longer there: drone.toml" in content
    assert 'class="sortable estimates"' in page(run, tmp_path, drone=run / "my_drone.toml")


def test_of_several_of_a_kind_the_usual_output_is_shown_else_the_latest(run: Path) -> None:
    for name in ("b.toml", "a.toml"):
        shutil.copy(run / "drone.toml", run / name)
        manifest.append(run / name, "identify", {"drone": [run / name]}, RECORD)
    assert find_files(run, {}).first("drone") == run / "drone.toml"
    (run / "drone.toml").unlink()
    assert find_files(run, {}).first("drone") == run / "a.toml"
    assert find_files(run, {}).others == {"identified drones": ["b.toml"]}


def test_a_log_that_a_run_lists_is_shown_alone(run: Path) -> None:
    for name in ("transfer/flight_02.csv", "recorded/flight_01.csv"):
        found = runs.read_run(run / name)
        assert [flight.name for flight in found.recorded] == [name]
        assert found.table is None
        assert found.drone is None


@pytest.mark.parametrize("name", ["nowhere", "notes.txt"])
def test_what_is_not_there_or_in_no_manifest_is_refused(name: str, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(InputError, match=rf"{name}: no.*--logs .*{name}.*--drone"):
        find_files(tmp_path / name, {})


def test_a_file_of_a_user_that_is_not_there_or_of_a_wrong_kind_is_refused(run: Path) -> None:
    with pytest.raises(InputError, match=r"none\.toml: no such file"):
        find_files(run, {"drone": run / "none.toml"})
    with pytest.raises(InputError, match=r"transfer: is a folder\. Give the file after --flights"):
        find_files(run, {"flights": run / "transfer"})
    with pytest.raises(InputError, match=r"recorded.flight_01\.csv"):
        runs.read_run(run, {"drone": run / "recorded" / "flight_01.csv"})
    with pytest.raises(InputError, match="missing column"):
        runs.read_run(run, {"validation": run / "transfer" / "flights.csv"})


def test_a_run_of_which_nothing_is_left_is_refused(run: Path, tmp_path: Path) -> None:
    (tmp_path / "left").mkdir()
    shutil.copy(run / "run.json", tmp_path / "left")
    with pytest.raises(InputError, match=r"lists recorded/flight_01\.csv, which is no longer"):
        report(tmp_path / "left", tmp_path / "page.html")


def test_logs_of_other_flights_are_not_taken_for_those_of_a_table(run: Path) -> None:
    flight_csv.write(run / "transfer" / "flight_04.csv", circling(1.0))
    with pytest.raises(InputError, match=r"flights\.csv: 4 flight logs, but 3 rows"):
        runs.read_run(None, {"flights": run / "transfer" / "flights.csv"})
    (run / "transfer" / "flight_01.csv").unlink()
    with pytest.raises(InputError, match=r"flights\.csv: 2 flight logs, but 3 rows"):
        runs.read_run(run)


def test_a_folder_of_logs_is_searched_as_identify_does(tmp_path: Path) -> None:
    flight_csv.write(tmp_path / "deep" / "er" / "monday.csv", circling(1.0, simulated=""))
    flight_csv.write(tmp_path / "deep" / "tuesday.csv", circling(1.0, simulated=""))
    for name in ("flight_10", "flight_9"):
        text = authors_text(authors_columns(120))
        results.write(tmp_path / "theirs" / f"{name}.csv", text)
    results.write(tmp_path / "deep" / "other.csv", "a,b\n1,2\n")
    found = runs.read_run(None, {"logs": tmp_path})
    assert [flight.name for flight in found.recorded] == [
        "er/monday.csv",
        "deep/tuesday.csv",
        "theirs/flight_9.csv",
        "theirs/flight_10.csv",
    ]
    assert (found.logs, len(found.refused)) == (4, 1)
    assert "other.csv" in found.refused[0]
    flight_csv.write(tmp_path / "deep" / "tuesday.csv", circling(1.0, simulated=""))
    (tmp_path / "deep" / "tuesday.csv").write_text("# maidenflight flight 1\n0\n")
    with pytest.raises(InputError, match=r"tuesday\.csv: not a flight log"):
        runs.read_run(None, {"logs": tmp_path})


def test_logs_of_any_format_that_a_drone_was_identified_from_are_shown(
    run: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "flown"
    logs = [results.write(folder / "in" / "monday.csv", authors_text(authors_columns(120)))]
    shutil.copy(run / "drone.toml", folder)
    made = results.record(seed=1, inputs=logs, settings={})
    manifest.append(
        folder / "drone.toml", "identify", {"drone": [folder / "drone.toml"]}, made, {"logs": logs}
    )
    found = runs.read_run(folder)
    assert [flight.name for flight in found.recorded] == ["in/monday.csv"]
    results.write(folder / "in" / "monday.csv", "a,b\n1,2\n")
    assert runs.read_run(folder).recorded == (), "these are other flights now"
    with pytest.raises(InputError, match=r"monday\.csv"):
        runs.read_run(folder, {"logs": [folder / "in" / "monday.csv"]})


def test_real_flights_in_the_authors_format_are_shown(shared_data: Path) -> None:
    logs = shared_data / "authors" / "flights" / "attitude" / "policy_118"
    found = runs.read_run(None, {"logs": logs})
    assert len(found.recorded) == found.logs > 0
    assert not any(flight.simulated for flight in found.recorded)
    assert runs.viewable(found) == list(range(len(found.recorded)))
