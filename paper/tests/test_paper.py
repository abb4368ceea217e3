"""The scripts that redo the paper's tables run, on little."""

import dataclasses
import itertools
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import polars
import pytest

from maidenflight import parameters, policy_file
from maidenflight.flights import flight_csv
from maidenflight.simulator.controllers.interface import INTERFACES
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.studies import worker
from maidenflight.studies.worker import Order, TaskResult
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.settings import PPO
from maidenflight.verbs.train import Train
from scripts import PAPER, script


@pytest.fixture(scope="module")
def table_2() -> Any:
    return script("table_2")


@pytest.mark.night
def test_table_2_stands_beside_the_papers_and_the_truth(
    table_2: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Virtual flights and, from files, others in two folders, of which one is called as a control
    structure is."""
    (flight,) = table_2.virtual_flights(7, 1, 6.0)
    flight_csv.write(tmp_path / "logs" / "pwm" / "flight.csv", flight, {})
    small = ["--small", "--lengths", "30", "--trials", "1", "--flights", "1", "--evaluations", "12"]
    table_2.main([*small, "--logs", str(tmp_path / "logs"), "-o", str(tmp_path / "made")])
    told = capsys.readouterr().out
    data = polars.read_csv(tmp_path / "made" / "table_2.csv", comment_prefix="#")
    assert data.height == 2 * 2 * 3
    assert set(data["flights"]) == {"virtual", "pwm"}
    assert data.filter(polars.col("flights") == "virtual")["truth"].null_count() == 0
    assert data.filter(polars.col("flights") == "pwm")["truth"].null_count() == 6
    assert (data["low"] <= data["value"]).all()
    assert (data["objective_at_paper"] > 0).all()
    text = (tmp_path / "made" / "table_2.md").read_text()
    for words in ("1.725 +- 0.0018", "88.0 +- 0.60", "18.0 +- 0.30", "paper's lies", "28 g"):
        assert words in told
        assert words in text


@pytest.fixture(scope="module")
def predict_flights() -> Any:
    return script("predict_flights")


def test_calibration_is_the_share_of_real_flights_within_their_policys_band(
    predict_flights: Any,
) -> None:
    compared = polars.DataFrame(
        {"policy": ["a", "b"], "quantile_10": [1.0, 5.0], "quantile_90": [2.0, 20.0]}
    )
    flights = polars.DataFrame(
        {"name": ["b", "a", "a", "a", "b"], "flight_time_s": [4.9, 0.9, 1.0, 1.5, 20.0]}
    )
    assert predict_flights.within_band(compared, flights) == pytest.approx(3 / 5)


def test_a_value_lies_below_inside_or_above_an_interval(table_2: Any) -> None:
    assert [table_2.where(value, 1.0, 2.0) for value in (0.9, 1.0, 1.5, 2.0, 2.1)] == [
        "below",
        "inside",
        "inside",
        "inside",
        "above",
    ]


@pytest.mark.night
def test_history_and_hidden_layers_are_studied(
    tmp_path: Path, monkeypatch: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    """One kind that stands in both tables, because each compiles anew."""
    study = script("history_and_hidden")
    monkeypatch.setattr(study, "HIDDEN", (8, 8))
    monkeypatch.setattr(study, "HISTORY", 3)
    few = [
        "--updates",
        "1",
        "--seeds",
        "2",
        "--episodes",
        "4",
        "--trials",
        "2",
        "--duration",
        "0.3",
    ]
    study.main([*few, "--histories", "3", "--hidden", "8x8", "-o", str(tmp_path / "study.csv")])
    data = polars.read_csv(tmp_path / "study.csv", comment_prefix="#")
    assert data["history"].to_list() == [3, 3]
    assert data["hidden"].to_list() == ["8x8", "8x8"]
    assert data["parameters"].to_list() == [596, 596]
    assert data["flight_time"].is_between(0.01, 0.3).all()
    told = capsys.readouterr().out
    for words in ("| H |", "| hidden layers |", "| 3 | 596 |", "| 8x8 | 596 |"):
        assert words in told
    assert '"reality": "virtual:7"' in (tmp_path / "study.csv").read_text()


@pytest.fixture(scope="module")
def figure_4() -> Any:
    return script("figure_4")


LEARNERS = {
    "pwm": AnalyticGradient(updates=800, hidden_learning_rate=0.0, action_change_penalty=0.0),
    "attitude_rate": AnalyticGradient(
        updates=600, hidden_learning_rate=0.0, action_change_penalty=0.0, horizon=32
    ),
    "attitude": AnalyticGradient(
        updates=600, hidden_learning_rate=0.0, action_change_penalty=0.0, horizon=32
    ),
}
"""With which paper/notes/zero-shot.md was measured."""


@pytest.mark.parametrize(("name", "rate"), [("zero_shot", None), ("zero_shot_100hz", 100)])
def test_the_papers_studies_are_the_papers(figure_4: Any, name: str, rate: int | None) -> None:
    study = figure_4.read_study(PAPER / "settings" / f"{name}.toml")
    pairs, kinds = figure_4.find_flown_tasks(study), list(LEARNERS)[0 if rate is None else 1 :]
    assert len(study.tasks) == 2 * len(pairs)
    cells = {
        (trained.settings["control"], *(trained.settings["set"][one] for one in figure_4.CELL))
        for trained, _ in pairs
    }
    assert cells == set(itertools.product(kinds, (0.04, 0.08, 0.12), (0.0, 0.015, 0.02)))
    for trained, flown in pairs:
        assert flown.inputs == {"policies": trained.key}
        assert flown.settings["reality"] == ["near:7", "virtual:7", "far:7"]
        assert (flown.settings["trials"], flown.settings["duration"]) == (3, 20)
        training = Train.from_settings(trained.settings)
        assert isinstance(training, Train)
        own, learner = INTERFACES[training.control]().rate, LEARNERS[training.control]
        assert training.rate == rate
        assert flown.settings["rate"] in (own, None if rate is None else own)
        # As far ahead in time, whatever the rate.
        if rate is not None:
            learner = dataclasses.replace(learner, horizon=64)
        assert training.spec == PolicySpec()
        assert training.learner_settings == learner
        assert training.task == "paper_circle"
        assert (training.policies, training.randomize, training.paper_scales) == (3, 0.1, True)


def test_the_study_by_ppo_flies_the_cells_of_that_by_gradients(figure_4: Any) -> None:
    by_ppo, by_gradients = (
        figure_4.find_flown_tasks(figure_4.read_study(PAPER / "settings" / f"{name}.toml"))
        for name in ("zero_shot_ppo", "zero_shot")
    )
    assert [task.settings["seed"] for task, _ in by_ppo] == [0] * 27 + [1] * 27 + [2] * 27
    for (trained, flown), (other, _) in zip(by_ppo, 3 * by_gradients, strict=True):
        assert flown.settings["reality"] == ["near:7", "virtual:7", "far:7"]
        training = Train.from_settings(trained.settings)
        assert isinstance(training, Train)
        assert training.learner_settings == PPO(updates=400)
        same = ("drone", "task", "control", "set", "randomize", "paper_scales")
        assert {name: trained.settings[name] for name in same} == {
            name: other.settings[name] for name in same
        }


def test_a_small_study_trains_a_policy_a_cell_for_a_third_as_long(figure_4: Any) -> None:
    small = figure_4.read_study(PAPER / "settings" / "zero_shot.toml", small=True)
    trained = [task.settings for task in small.tasks if task.kind == "train"]
    assert len(trained) == 27
    assert {one["policies"] for one in trained} == {1}
    assert {one["control"]: one["updates"] for one in trained} == {
        "pwm": 266,
        "attitude_rate": 200,
        "attitude": 200,
    }


def test_a_study_that_flies_no_cells_is_refused(figure_4: Any, tmp_path: Path) -> None:
    text = (PAPER / "settings" / "zero_shot.toml").read_text()
    (tmp_path / "study.toml").write_text(text.replace('"set.latency"', '"set.drag_x"'))
    with pytest.raises(figure_4.InputError, match=r"set\.latency"):
        figure_4.read_study(tmp_path / "study.toml")


TINY = """
[[task]]
name = "trained"
kind = "train"
[task.settings]
control = "pwm"
rate = 50
drone = "crazyflie"
randomize = 0.1
policies = 2
updates = 3
hidden = [8]
learner = { num_envs = 2, horizon = 2, evaluations = 1, episodes = 2, hidden_learning_rate = 0 }
[task.grid]
"set.motor_time_constant" = [0.04, 0.08]
"set.latency" = [0.0, 0.015]

[[task]]
name = "flown"
kind = "transfer"
inputs = { policies = "trained" }
[task.settings]
reality = ["near:7"]
trials = 2
duration = 0.4
rate = 25
"""


class Here:
    """An engine that does tasks in this process, where other tests compile the same."""

    def __init__(self) -> None:
        self._waiting: list[Order] = []

    def room(self) -> int:
        return 1 - len(self._waiting)

    def submit(self, order: Order) -> None:
        self._waiting.append(order)

    def ended(self, timeout: float) -> list[TaskResult]:
        orders, self._waiting = self._waiting, []
        return [worker.perform(order) for order in orders]

    def close(self) -> None:
        pass


@pytest.mark.night
def test_figure_4_computes_gathers_and_draws_a_study_and_goes_on_where_it_was(
    figure_4: Any,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "study.toml").write_text(TINY)
    write_published_flights(tmp_path)
    made, sweep = tmp_path / "made", figure_4.mf.sweep
    monkeypatch.setattr(
        figure_4.mf, "sweep", lambda *given, **more: sweep(*given, Here(), retries=0, **more)
    )
    arguments = ["--settings", str(tmp_path / "study.toml"), "--authors", str(tmp_path)]
    arguments += ["--small", "-o", str(made)]
    figure_4.main(arguments)
    table = made / "flights.csv"
    flights, record = figure_4.FLIGHTS.read(table)
    assert flights.height == 4 * 2
    assert set(flights["training_rate"]) == {50}
    assert set(flights["number"]) == {1}
    assert flights["policy"].n_unique() == 4
    assert "pwm_80ms_15ms/1" in set(flights["policy"])
    assert (record["settings"]["drone"], record["settings"]["duration"]) == ("crazyflie", 0.4)
    # At 25 Hz a flight lasts a whole number of 40 ms.
    periods = flights["duration"].to_numpy() / 0.04
    np.testing.assert_allclose(periods, np.round(periods), atol=1e-6)
    picture = made / "figure_4.svg"
    drawn = picture.read_text()
    assert all(
        f"{name}: latency {latency} ms in training" in drawn
        for name in ("near:7", "real")
        for latency in (0, 15)
    )
    assert "T_m 80 ms" in capsys.readouterr().out
    kept = [policy_file.read_policy(path) for path in made.glob("results/*/policies/policy_*.json")]
    assert len(kept) == 4
    assert {(one.interface.name, one.interface.rate, one.spec.hidden) for one in kept} == {
        ("pwm", 50, (8,))
    }
    before, results = table.read_bytes(), made / "results"
    times = {folder.name: folder.stat().st_mtime_ns for folder in results.iterdir()}
    table.unlink()
    picture.unlink()
    flown = next(folder for folder in results.iterdir() if (folder / "transfer").exists())
    shutil.rmtree(flown)
    figure_4.main(arguments)
    assert (table.read_bytes(), picture.read_text()) == (before, drawn)
    again = {folder.name: folder.stat().st_mtime_ns for folder in results.iterdir()}
    assert {name for name in times if times[name] != again[name]} == {flown.name}


def test_the_cells_of_flights(figure_4: Any, capsys: pytest.CaptureFixture[str]) -> None:
    table = polars.DataFrame(
        {
            "reality": ["x"] * 4 + ["y"],
            "control": ["pwm"] * 5,
            "motor_time_constant": [0.04] * 4 + [0.08],
            "latency": [0.0] * 5,
            "number": [1, 1, 2, 2, 1],
            "duration": [20.0, 1.0, 2.0, 3.0, 4.0],
            "end_reason": ["time limit", "tilt", "tilt", "tilt", "tilt"],
        }
    )
    cells = figure_4.summarize_cells(table)
    row, _ = cells.to_dicts()
    assert (row["policies"], row["flights"], row["mean"], row["median"], row["share"]) == (
        2,
        4,
        6.5,
        2.5,
        0.25,
    )
    figure_4.print_cells(cells)
    printed = capsys.readouterr().out
    assert "6.5 s   25%" in printed
    assert "T_m 80 ms" in printed


def write_published_flights(folder: Path) -> None:
    """Writes a flight of the paper, and another one, as the authors' data has them."""
    flights = {
        "in_paper": [1, 0],
        "control": ["pwm"] * 2,
        "trained_motor_time_constant_s": [0.08] * 2,
        "trained_latency_s": [0.015] * 2,
        "flight_time_s": [26.0, 1.0],
    }
    polars.DataFrame(flights).write_csv(folder / "flights.csv")


def test_only_flights_of_the_paper_are_drawn_beside_ours_and_no_longer_than_20_s(
    figure_4: Any, tmp_path: Path
) -> None:
    write_published_flights(tmp_path)
    assert figure_4.read_published_flights(tmp_path)["duration"].to_list() == [20.0]
    with pytest.raises(figure_4.InputError, match="authors' data"):
        figure_4.read_published_flights(tmp_path / "nothing")


@pytest.mark.slow
def test_slow_logs_are_compared_with_and_without_an_accelerometer(monkeypatch: Any) -> None:
    rates = script("log_rates")
    monkeypatch.setattr(rates.accepted, "LONGEST_PERIOD", rates.accepted.LONGEST_PERIOD)
    given: list[Any] = []

    def identify(flights: Any, *_: Any, **__: Any) -> Any:
        given.append(flights[0])
        samples = {"motor_time_constant": np.full(9, 0.07), "latency": np.full(9, 0.01)}
        estimates = {"inertia_x": SimpleNamespace()}
        return SimpleNamespace(
            posterior=samples, estimates=estimates, parameters=parameters.crazyflie()
        )

    monkeypatch.setattr(rates.mf, "identify", identify)
    found = rates.table([7], [1, 3], 1.0)
    assert found["rate"].to_list() == [100.0, 100.0, 33.3, 33.3]
    assert found["accelerometer"].to_list() == [True, False, True, False]
    assert [flight.accelerometer is not None for flight in given] == [True, False, True, False]
    assert [len(flight) for flight in given] == [100, 100, 34, 34]
    assert found["found"].to_list() == [80.0] * 4
    assert not found["lag told"].any()
    assert found["inertia told"].all()
    assert rates.summary(found).height == 4
