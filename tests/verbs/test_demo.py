"""The demo: every stage by its verb, the same bytes by the same seed."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maidenflight import run_folder, terminal
from maidenflight.flying import engine
from maidenflight.identification import drone_file
from maidenflight.training import analytic_gradient, evaluation
from maidenflight.verb import Progress, Result
from maidenflight.verbs.demo import Demo, Stages
from maidenflight.verbs.identify import Identify
from maidenflight.verbs.record import Record
from maidenflight.verbs.train import Train
from maidenflight.verbs.transfer import Transfer
from maidenflight.verbs.validate import Validate
from quick import make_identification_quick, make_training_quick
from run_listing import entries, unlisted

LESS = Stages(
    Record(flights=2, duration=4.0),
    Identify(logs=Path("."), over=("thrust_to_weight", "latency"), trials=1, evaluations=15),
    Train(randomize=0.1, accept_bounds=True),
    Transfer(policies=(".",), accept_bounds=True, trials=2, duration=0.5, against=()),
)
pytestmark = pytest.mark.slow


class Heard(Progress):
    """Keeps the lines that are always written."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def log(self, line: str, always: bool = False) -> None:
        if always:
            self.lines.append(line)


HEARD = Heard()
MOST_PROGRAMS = {analytic_gradient.update: 1, evaluation.evaluate_together: 1, engine._simulate: 3}
"""That demos compile: of flights the recorded ones' and the policies', in training and after."""
COMPILED: dict[Any, int] = {}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, Result]]:
    """A demo's folder and result."""
    with pytest.MonkeyPatch.context() as patch:
        make_identification_quick(patch)
        make_training_quick(patch)
        folder = tmp_path_factory.mktemp("one") / "run"
        COMPILED.update((one, -one._cache_size()) for one in MOST_PROGRAMS)  # type: ignore[attr-defined]
        result = Demo(seed=3).compute(folder, HEARD, LESS)
        COMPILED.update((one, size + one._cache_size()) for one, size in COMPILED.items())
        yield folder, result


def test_every_stage_runs_in_order_and_leaves_its_results(
    run: tuple[Path, Result],
) -> None:
    folder, result = run
    stages = ["record", "identify", "train", "transfer", "export", "report"]
    assert [line.split()[0] for line in HEARD.lines[:6]] == stages
    assert list(result.content["stages"]) == stages
    written = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    assert written == {
        *(
            "drone.toml",
            "identification.csv",
            "identification.svg",
            "demo.json",
            "run.json",
            "report.html",
        ),
        *("recorded/reality.toml", *(f"recorded/flight_0{number}.csv" for number in (1, 2))),
        *(f"policies/policy_{number}.json" for number in (1, 2, 3)),
        *("policies/training.csv", "policies/training.npz"),
        *(f"transfer/flight_0{number}.csv" for number in range(1, 7)),
        "transfer/flights.csv",
        *("firmware/policy.h", "firmware/policy.c"),
    }
    assert unlisted(folder) == {"report.html", "policies/training.npz"}
    assert entries(folder) == {
        ("record", "recorded"): {"logs", "truth"},
        ("identify", "drone.toml"): {"drone", "evaluations", "picture"},
        ("train", "policies"): {"policies", "training"},
        ("transfer", "transfer"): {"flights", "flight_logs"},
        ("export", "firmware"): {"exported"},
        ("demo", "demo.json"): {"stages"},
    }
    assert len(result.content["flights"]) == 6
    assert json.loads((folder / "demo.json").read_text())["seed"] == 3


@pytest.mark.night
def test_the_same_seed_gives_the_same_bytes(run: tuple[Path, Result], tmp_path: Path) -> None:
    one, two = run[0], tmp_path / "run"
    Demo(seed=3).compute(two, Heard(), LESS)
    different = [
        str(path.relative_to(one))
        for path in sorted(one.rglob("*"))
        if path.is_file() and path.read_bytes() != (two / path.relative_to(one)).read_bytes()
    ]
    assert set(different) <= {"demo.json"}, "it alone tells how long the stages took"


def test_programs_that_are_compiled_ahead_are_those_that_the_verbs_run(
    run: tuple[Path, Result],
) -> None:
    assert {one: max(COMPILED[one], most) for one, most in MOST_PROGRAMS.items()} == MOST_PROGRAMS


def test_results_name_no_place_and_no_time(run: tuple[Path, Result]) -> None:
    folder, _ = run
    for path in folder.rglob("*"):
        if path.is_file():
            assert str(folder.parent).encode() not in path.read_bytes(), path


def test_the_truth_stays_hidden_from_the_identified_drone(
    run: tuple[Path, Result],
) -> None:
    text = (run[0] / "drone.toml").read_text()
    assert "battery_resistance = 0.0 " in text
    assert "estimator_delay = 0.0 " in text


def test_the_summary_says_what_intervals_do_not_cover_and_which_policy_was_exported(
    run: tuple[Path, Result], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, result = run
    terminal.show(*result.summary)
    out = capsys.readouterr().out
    best = Path(result.content["best"])
    assert f"of the best policy, {best.stem}" in out
    assert best.parent == folder / "policies"
    assert " sensors" in out


def test_the_page_shows_the_truth_beside_what_was_identified(
    run: tuple[Path, Result],
) -> None:
    assert "truth" in (run[0] / "report.html").read_text().lower()


@pytest.mark.night
def test_its_drone_is_calibrated_by_flights_of_its_posterior(
    run: tuple[Path, Result], tmp_path: Path
) -> None:
    folder, _ = run
    drone = folder / "drone.toml"
    verb = Validate(drone=str(drone), logs=folder / "recorded", calibration=True, draws=2)
    result = verb.run(tmp_path / "calibration.csv")
    posterior = drone_file.read(drone).posterior
    table, _ = run_folder.CALIBRATION.read(tmp_path / "calibration.csv")
    assert set(posterior) <= set(table["parameter"])
    for row in table.iter_rows(named=True):
        if row["parameter"] in posterior:
            assert np.isclose(posterior[row["parameter"]], row["truth"], rtol=1e-6).any()
        if np.isfinite(row["rank"]):
            assert row["low"] < row["high"]
    assert {row["draws"] for row in result.rows} == {2}
