"""The kinds of maidenflight, each done once: tasks are what the commands would make."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import polars
import pytest
from test_sweeping import Here

import maidenflight as mf
import run_listing
from maidenflight import run_folder, workflow
from maidenflight.identification.drone_file import DroneFile
from quick import QUICK

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def less_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("maidenflight.simulator.trajectories.QUICKENING", 1.0)
    monkeypatch.setattr("maidenflight.experiments.envelope.DURATION_S", 0.1)
    monkeypatch.setattr(workflow, "settings_for", lambda *_: QUICK)


def test_a_study_of_every_kind_goes_from_logs_to_flights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "flight_1.csv").write_text("a log")

    def identify(*given: Any, **settings: Any) -> tuple[None, SimpleNamespace]:
        """Identification is tested elsewhere, and is long."""
        DroneFile(mf.crazyflie()).write(given[2])
        estimate = SimpleNamespace(value=0.03, interval=(0.02, 0.04))
        assert settings["over"] == ["thrust_to_weight", "latency"]
        return None, SimpleNamespace(estimates=dict.fromkeys(settings["over"], estimate))

    monkeypatch.setattr(workflow, "identify_from", identify)
    entries: list[dict[str, Any]] = [
        {
            "name": "drone",
            "kind": "identify",
            "settings": {
                "logs": str(tmp_path / "logs"),
                "over": ["thrust_to_weight", "latency"],
                "trials": 1,
                "evaluations": 15,
            },
        },
        {
            "name": "policy",
            "kind": "train",
            "settings": {"policies": 3},
            "inputs": {"drone": "drone"},
        },
        {
            "name": "flown",
            "kind": "transfer",
            "settings": {"trials": 1, "duration": 0.5},
            "inputs": {"policies": "policy", "drone": "drone"},
        },
        {
            "name": "times",
            "kind": "predict",
            "settings": {"trials": 2, "duration": 0.5},
            "inputs": {"policies": "policy", "drone": "drone"},
        },
        {
            "name": "hard",
            "kind": "envelope",
            "settings": {"along": ["circle"], "flights": 1},
            "inputs": {"policies": "policy"},
        },
    ]
    table = mf.sweep(entries, tmp_path / "out", Here(), retries=0)
    counts = dict(table.group_by("task").len().iter_rows())
    assert counts == {"drone": 2, "policy": 3, "flown": 3, "times": 3, "hard": 3}
    folder = Path(next((tmp_path / "out" / "results").glob("*/policies")))
    assert len(run_folder.POLICY.find(folder)) == 3
    assert not (folder / run_folder.CHECKPOINT).exists()
    rows = run_folder.STUDY.read(tmp_path / "out" / "study.csv")[0]
    assert rows.height == 14
    assert run_listing.entries(tmp_path) == {("sweep", "out"): {"study"}}
    made = [run_listing.entries(place) for place in (tmp_path / "out" / "results").iterdir()]
    assert [list(one.values()) for one in sorted(made, key=str)] == [
        [{"envelope", "picture"}],
        [{"prediction"}],
        [{"policies", "training"}],
        [{"flights", "flight_logs"}],
        [],  # of the stand-in
    ]
    for place in (tmp_path / "out" / "results").iterdir():
        assert run_listing.unlisted(place) <= {"result.json", "drone.toml"}
    flown = table.filter(polars.col("task") == "flown")
    assert set(flown["policy"]) == {"policy_1", "policy_2", "policy_3"}
    assert flown["duration"].is_between(0.0, 0.5).all()
