import json

import pytest
from maidenflight.demo import Demo, Listener, Plan, demo

import quick
from maidenflight.identification.likelihood import Likelihood
from maidenflight.terminal import demo_output
from run_listing import entries, unlisted

QUICK = Plan(
    flights=2,
    duration=4.0,
    identification=Likelihood(
        trials=1, evaluations=15, physics_step=0.005, coarse_physics_step=0.005
    ),
    policies=3,
    learner=quick.QUICK,
    flight_trials=2,
    longest=0.5,
)
HEARD: list[str] = []
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Demo, Demo]:
    listener = Listener(HEARD.append, lambda progress: None, lambda progress: None)
    one, two = (tmp_path_factory.mktemp(name) / "run" for name in ("one", "two"))
    return demo(one, 3, QUICK, listener), demo(two, 3, QUICK, listener)


def test_every_stage_runs_in_order_and_leaves_its_results(runs: tuple[Demo, Demo]) -> None:
    result = runs[0]
    stages = ["record", "identify", "train", "transfer", "export", "report"]
    assert HEARD[:6] == stages
    assert list(result.seconds) == stages
    written = {
        str(path.relative_to(result.folder)) for path in result.folder.rglob("*") if path.is_file()
    }
    assert written == {
        *(
            "reality.toml",
            "drone.toml",
            "identification.csv",
            "identification.svg",
            "demo.json",
            "run.json",
            "report.html",
        ),
        *(f"recorded/flight_0{number}.csv" for number in (1, 2)),
        *(f"policies/policy_{number}.json" for number in (1, 2, 3)),
        *("policies/training.csv", "policies/training.npz"),
        *(f"transfer/flight_0{number}.csv" for number in range(1, 7)),
        "transfer/flights.csv",
        *("firmware/policy.h", "firmware/policy.c"),
    }
    assert unlisted(result.folder) == {"report.html", "policies/training.npz"}
    assert entries(result.folder) == {
        ("record", "recorded"): {"logs", "truth"},
        ("identify", "drone.toml"): {"drone", "evaluations", "picture"},
        ("train", "policies"): {"policies", "training"},
        ("transfer", "transfer"): {"flights", "flight_logs"},
        ("export", "firmware"): {"exported"},
        ("demo", "demo.json"): {"stages"},
    }
    assert result.transfer.table.height == 6
    assert json.loads((result.folder / "demo.json").read_text())["seed"] == 3


def test_the_same_seed_gives_the_same_bytes(runs: tuple[Demo, Demo]) -> None:
    one, two = (result.folder for result in runs)
    different = [
        str(path.relative_to(one))
        for path in sorted(one.rglob("*"))
        if path.is_file() and path.read_bytes() != (two / path.relative_to(one)).read_bytes()
    ]
    assert set(different) <= {"demo.json", "report.html"}, (
        "only these two tell how long the stages took"
    )


def test_results_name_no_place_and_no_time(runs: tuple[Demo, Demo]) -> None:
    for path in runs[0].folder.rglob("*"):
        if path.is_file():
            assert str(runs[0].folder.parent).encode() not in path.read_bytes(), path


def test_the_truth_stays_hidden_from_the_identified_drone(runs: tuple[Demo, Demo]) -> None:
    text = (runs[0].folder / "drone.toml").read_text()
    assert "battery_resistance = 0.0 " in text
    assert "estimator_delay = 0.0 " in text


def test_the_summary_says_what_intervals_do_not_cover_and_which_policy_was_exported(
    runs: tuple[Demo, Demo], capsys: pytest.CaptureFixture[str]
) -> None:
    demo_output.summary(runs[0])
    out = capsys.readouterr().out
    assert f"of the best policy, {runs[0].best.stem}" in out
    assert runs[0].best.parent == runs[0].folder / "policies"
    assert " sensors" in out
