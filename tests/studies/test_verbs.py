"""Verbs as tasks of a study, each run once: tasks are what the commands would make."""

from pathlib import Path
from typing import Any

import polars
import pytest
from jaxtyping import Array
from test_sweeping import Here
from toy_kinds import entry

import maidenflight as mf
import run_listing
from maidenflight import policy_file, run_folder
from maidenflight.identification.drone_file import DroneFile
from maidenflight.policy import Policy, untrained_policy
from maidenflight.simulator.controllers.control import Controller
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.training import defaults, final_flights
from maidenflight.verb import Progress, Result
from maidenflight.verbs.identify import Identify
from quick import QUICK, replace_training

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def less_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("maidenflight.simulator.tasks.trajectories.RAMP_DURATION_S", 1.0)
    monkeypatch.setattr("maidenflight.experiments.envelope.DURATION_S", 0.1)
    monkeypatch.setattr(defaults, "choose_settings", lambda *_: QUICK)
    own = [final_flights.FinalFlight("itself", "mine", 20.0, "time limit", 0.01)] * 3
    monkeypatch.setattr(final_flights, "fly_drones", lambda *_: [own] * 3)

    def make(
        _: Any, controller: Controller, __: Any, keys: Array, *, policy: PolicySpec
    ) -> list[Policy]:
        return [untrained_policy(key, controller.interface, policy) for key in keys]

    replace_training(monkeypatch, make)


def test_a_study_goes_from_logs_to_flights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "flight_1.csv").write_text("a log")

    def identify(self: Identify, output: Path, progress: Progress) -> Result:
        """Identification is tested elsewhere, and is long."""
        DroneFile(mf.crazyflie()).write(output)
        over = ("thrust_to_weight", "latency")
        assert self.over == over
        assert (self.objective, self.bounds) == ("replay", {"latency": (0.0, 0.03)})
        return Result(rows=[{"parameter": name, "value": 0.03} for name in over])

    monkeypatch.setattr(Identify, "compute", identify)
    source = {
        "logs": str(tmp_path / "logs"),
        "over": ["thrust_to_weight", "latency"],
        "objective": "replay",
        "bounds": {"latency": [0.0, 0.03]},
        "battery_law": "thrust upgrade",
    }
    ahead = {"drone": "crazyflie", "policies": 3, "look_ahead": 2, "for": "c"}
    made: Any = {"policies": "policy", "drone": "drone"}
    entries = [
        entry("drone", "identify", source),
        entry("policy", "train", {"policies": 3, "set": {"latency": 0.01}}, drone="drone"),
        entry("ahead", "train", ahead),
        entry("flown", "transfer", {"trials": 1, "duration": 0.5, "against": []}, **made),
        entry("times", "predict", {"trials": 2, "duration": 0.5, "against": []}, **made),
        entry("hard", "envelope", {"along": ["circle"], "flights": 1}, policies="policy"),
    ]
    table = mf.sweep(entries, tmp_path / "out", Here(), retries=0)
    counts = dict(table.group_by("task").len().iter_rows())
    assert counts == {"drone": 2, "policy": 3, "ahead": 3, "flown": 3, "times": 3, "hard": 3}
    folders = sorted((tmp_path / "out" / "results").glob("*/policies"))
    assert len(folders) == 2
    for folder in folders:
        assert len(run_folder.POLICY.find(folder)) == 3
        assert not (folder / run_folder.CHECKPOINT).exists()
    policies = [policy_file.read_policy(folder / "policy_1.json") for folder in folders]
    assert {one.spec.look_ahead.points for one in policies} == {0, 2}
    rows = run_folder.STUDY.read(tmp_path / "out" / "study.csv")[0]
    assert rows.height == 17
    assert run_listing.entries(tmp_path) == {("sweep", "out"): {"study"}}
    listed = [run_listing.entries(place) for place in (tmp_path / "out" / "results").iterdir()]
    assert [list(one.values()) for one in sorted(listed, key=str)] == [
        [{"envelope", "picture"}],
        [{"prediction"}],
        [{"policies", "training"}],
        [{"policies", "training"}],
        [{"flights", "flight_logs"}],
        [],  # of the stand-in
    ]
    for place in (tmp_path / "out" / "results").iterdir():
        assert run_listing.unlisted(place) <= {"result.json", "drone.toml"}
    flown = table.filter(polars.col("task") == "flown")
    assert set(flown["policy"]) == {"policy_1", "policy_2", "policy_3"}
    assert flown["duration"].is_between(0.0, 0.5).all()
