"""The live view: what is sent to rerun is the flight; the package itself may be missing, and a
stand-in listens then."""

import subprocess
import sys
from importlib.util import find_spec
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

from maidenflight.errors import InputError
from maidenflight.flights.log import Flight
from maidenflight.integrations.monitoring import live
from maidenflight.policy import Policy
from maidenflight.training.evaluation import Evaluation
from maidenflight.training.train import Progress


def flight(rows=5) -> Flight:
    """Climbs at 1 m/s below its set-point by 3 cm, turned by 90 degrees about z."""
    time, still = 0.01 * np.arange(rows), np.zeros((rows, 3))
    position = np.stack([0 * time, 0 * time, time], axis=1)
    attitude = np.tile([0.0, 0.0, np.pi / 2], (rows, 1))
    command = np.tile([0.1, 0.2, 0.3, 0.4], (rows, 1))
    return Flight(
        "one/flight_01.csv",
        0.01,
        position,
        still,
        attitude,
        still,
        command,
        time,
        position + np.array([0, 0, 0.03]),
        True,
        "virtual-1",
    )


@pytest.fixture
def rerun(monkeypatch):
    """A stand-in for rerun that remembers what it was told."""
    package = MagicMock()
    monkeypatch.setitem(sys.modules, "rerun", package)
    monkeypatch.setitem(sys.modules, "rerun.blueprint", package.blueprint)
    return package


def sent(rerun):
    """Entities that columns were sent to."""
    return [call.args[0] for call in rerun.RecordingStream.return_value.send_columns.call_args_list]


def test_a_flight_is_shown_as_it_was_flown(rerun, tmp_path):
    live.show_flights([flight()], tmp_path / "new" / "flights.rrd")
    pose = rerun.Transform3D.columns.call_args.kwargs
    np.testing.assert_array_equal(pose["translation"], flight().position)
    np.testing.assert_allclose(
        pose["quaternion"], np.tile([0, 0, np.sqrt(0.5), np.sqrt(0.5)], (5, 1)), atol=1e-12
    )
    thrust = rerun.Arrows3D.columns.call_args.kwargs
    np.testing.assert_allclose(thrust["vectors"][:4, 2] / thrust["vectors"][0, 2], [1, 2, 3, 4])
    np.testing.assert_allclose(rerun.TimeColumn.call_args.kwargs["duration"], 0.01 * np.arange(5))
    lines = dict(
        zip(
            sent(rerun), rerun.RecordingStream.return_value.send_columns.call_args_list, strict=True
        )
    )
    assert {
        "001_flight_01/drone",
        "001_flight_01/setpoint",
        "001_flight_01/body_rates/z",
        "001_flight_01/command/4",
    } <= set(lines)
    error = rerun.Scalars.columns.call_args_list[-1].kwargs["scalars"]
    np.testing.assert_allclose(error, 3.0)
    rerun.RecordingStream.return_value.disconnect.assert_called_once()


def test_a_flight_without_set_points_or_with_rows_that_are_no_numbers_is_shown_as_far_as_it_goes(
    rerun, tmp_path
):
    broken = flight()
    broken.setpoint[:] = np.nan
    broken.position[3:] = np.nan
    live.show_flights([broken], tmp_path / "flights.rrd")
    assert len(rerun.Transform3D.columns.call_args.kwargs["translation"]) == 3
    assert not any(name.endswith(("/setpoint", "/error")) for name in sent(rerun))
    broken.position[:] = np.nan
    with pytest.raises(InputError, match="no flight to view"):
        live.show_flights([broken], tmp_path / "flights.rrd")


def test_the_viewer_is_started_where_no_file_is_asked_for(rerun, monkeypatch):
    monkeypatch.setenv("DISPLAY", ":0")
    live.show_flights([flight()])
    rerun.RecordingStream.return_value.spawn.assert_called_once()
    rerun.RecordingStream.return_value.save.assert_not_called()


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is always a display")
def test_without_a_display_the_viewer_is_not_started(rerun, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(InputError, match=r"needs a display.*-o FILE\.rrd"):
        live.show_flights([flight()])
    rerun.RecordingStream.assert_not_called()


def test_training_goes_on_when_the_viewer_is_gone(rerun, tmp_path, capsys):
    recording = rerun.RecordingStream.return_value
    recording.flush.side_effect = RuntimeError("gRPC connection severed")
    score = Evaluation(*(np.array([value]) for value in (-5.0, 0.5, 0.1)))  # type: ignore[arg-type]
    with live.training(lambda _: flight(), tmp_path / "training.rrd") as show:
        for update in (10, 20):
            show(Progress(update, 1000 * update, score))
    assert capsys.readouterr().err.count("the viewer is gone") == 1
    assert recording.set_time.call_args_list[-1].kwargs == {"duration": 0.0}
    assert len(recording.set_time.call_args_list) == 2


def test_training_shows_scores_and_how_the_best_policy_of_each_flies(rerun, tmp_path):
    weights = (np.array([[[1.0]], [[2.0]]], np.float32),)
    best = Policy(weights, (np.zeros((2, 1)),), np.zeros((2, 20)), np.ones((2, 20)))  # type: ignore[arg-type]
    flown = []

    def fly(policy):
        flown.append(float(policy.weights[0][0, 0]))
        return flight()

    recording = rerun.RecordingStream.return_value
    with live.training(fly, tmp_path / "training.rrd") as show:
        for update, returns in ((10, [-5.0, -9.0]), (20, [-4.0, -1.0])):
            scores: Any = (np.array(returns), np.array([0.5, 1.0]), np.array([0.1, 0.2]))
            show(Progress(update, 1000 * update, Evaluation(*scores), best))
    assert flown == [1.0, 2.0]
    assert [call.args[0] for call in recording.log.call_args_list].count(
        "scores/episode_return/policy_2"
    ) == 2
    began = [call.kwargs["duration"][0] for call in rerun.TimeColumn.call_args_list]
    assert min(began) == 0.0
    assert max(began) == pytest.approx(0.05 + 0.5), "the second flight follows the first"
    assert {call.kwargs.get("sequence") for call in recording.set_time.call_args_list} >= {
        10000,
        20000,
    }


@pytest.mark.skipif(find_spec("rerun") is None, reason="needs rerun-sdk, which is large")
def test_rerun_itself_reads_what_is_written(tmp_path):
    path = tmp_path / "flights.rrd"
    live.show_flights([flight(), flight(50)], path)
    checked = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "verify", str(path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert "1 file verified without error" in checked.stdout + checked.stderr
