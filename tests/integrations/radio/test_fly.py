"""`Fly`: what must be on board is compared before anything flies, and Enter confirms."""

import io
import os
import sys
from pathlib import Path
from types import SimpleNamespace

import jax
import pytest
from fake_drone import FakeDrone, Stepped

from maidenflight import policy_file, results
from maidenflight.deployment.c import digest
from maidenflight.errors import InputError
from maidenflight.integrations.radio import fly, session
from maidenflight.integrations.radio.fly import Fly
from maidenflight.policy import untrained_policy
from maidenflight.simulator.policy_spec import PolicySpec


def policy_of(folder: Path, mass: float) -> tuple[Path, str]:
    """A policy file made for a drone of some mass [kg], and its digest."""
    policy = untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(8,)))
    path = policy_file.write_policy(folder / "mine.json", policy, {"drone": {"mass": mass}})
    return path, digest(policy)


def test_the_policy_of_the_file_flies_and_is_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, sha256 = policy_of(tmp_path, 0.03)
    clock = Stepped(FakeDrone(policy=True))
    clock.fake.parameters["mf.hash"] = int(sha256[:8], 16)
    monkeypatch.setattr(session, "Crazyflie", lambda *_: clock.connect())
    monkeypatch.setattr(session, "WallClock", lambda: clock)
    monkeypatch.setattr(fly, "time", SimpleNamespace(sleep=clock.sleep))
    with clock.fake:
        flown = Fly(uri=clock.fake.uri, policy=path, duration=1.0, distance=0.3, yes=True)
        result = flown.run(tmp_path / "flown")
    assert result.exit_code == 0
    (log,) = (tmp_path / "flown").glob("*.csv")
    settings = results.read_record(log)["settings"]
    assert settings["policy"] == {"file": "mine.json", "sha256": sha256, "drone": {"mass": 0.03}}
    assert settings["limits_on_board"]["mf.distance"] == 0.3
    assert clock.fake.parameters["mf.distance"] == pytest.approx(0.3)


def test_another_drone_s_policy_is_refused_before_anything_connects(tmp_path: Path) -> None:
    path, _ = policy_of(tmp_path, 0.05)
    flown = Fly(uri="udp://127.0.0.1:9", policy=path, drone="crazyflie_2.1+")
    with pytest.raises(InputError, match=r"made for a drone of 50\.0 g"):
        flown.run(tmp_path / "flown")


def test_enter_takes_off_and_nobody_else_does(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n"))
    with pytest.raises(InputError, match="--yes"):
        fly._enter(lambda: 0)
    monkeypatch.setattr(fly, "time", SimpleNamespace(sleep=lambda _: None))
    leader, follower = os.openpty()
    with open(follower) as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        assert not fly._enter(lambda: 1)
        os.write(leader, b"\n")
        assert fly._enter(lambda: 0)
    os.close(leader)
