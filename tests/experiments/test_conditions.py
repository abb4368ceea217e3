"""Conditions of predicted flights: files of them, and the controllers of the published flights."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from maidenflight.errors import InputError
from maidenflight.experiments.conditions import CURRENT, controller_as_flown, read_conditions
from maidenflight.simulator.controllers import control, interface
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.tasks.failures import APP
from pages import ROOT

PUBLISHED = ROOT / "paper" / "settings" / "gronauer_2021.toml"


def test_flights_are_of_today_unless_a_file_has_others(tmp_path: Path) -> None:
    assert read_conditions(None) is CURRENT
    assert CURRENT.controller_for is control.controller_for
    assert not np.any([np.any(leaf) for leaf in CURRENT.start])
    assert CURRENT.guard == APP
    published = read_conditions(PUBLISHED)
    assert published.controller_for is controller_as_flown
    np.testing.assert_allclose(np.degrees(published.guard[:2]), [30.0, 800.0])
    assert published.guard.position_error == 2.5
    assert published.start.position == pytest.approx([0.029, 0.025, 0.029])
    assert (float(published.start.homeward), float(published.start.above)) == pytest.approx(
        (0.72, 0.014)
    )
    plain = tmp_path / "plain.toml"
    plain.write_text('conditions = 1\nfirmware = "2021.10"\n')
    conditions = read_conditions(plain)
    assert conditions[1:] == CURRENT[1:]
    own = conditions.controller_for(interface.attitude())
    assert own is control.controller_for(interface.attitude(), "2021.10")
    assert own is not CURRENT.controller_for(interface.attitude())


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("conditions = 1", "conditions = 2", "conditions is 2"),
        ("2021.10 as flown", "2019", "firmware is 2019"),
        ("homeward = 0.72 ", "homeward = 1.72 ", "homeward is 1.72"),
        ("[0.029, 0.025, 0.029]", "[0.029, 0.025]", "position is .*expected 3 numbers"),
        ("above = ", "below = ", "above is missing"),
        ("tilt_deg = 30.0", "tilt_deg = -30.0", "tilt_deg is -30"),
        ("[guard]", "[gaurd]", r"gaurd is .*no such entry"),
    ],
)
def test_what_is_no_condition_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = PUBLISHED.read_text()
    assert old in text
    (tmp_path / "other.toml").write_text(text.replace(old, new))
    with pytest.raises(InputError, match=rf"other.toml: \[.*{message}"):
        read_conditions(tmp_path / "other.toml")


@pytest.mark.parametrize("output", [0.5, 1.3])
def test_attitude_is_asked_for_without_clipping(output: float) -> None:
    """Rate PIDs get 6 + 3 x 2 ms times 10 deg; the first tick's derivative saturates them, the
    second's does not."""
    flown = controller_as_flown(interface.attitude())
    level = Measurement(jnp.zeros(3), jnp.zeros(3), jnp.array([0.0, 0.0, 0.0, 1.0]), jnp.zeros(3))
    memory, action = flown.init(), jnp.array([0.0, output, 0.0, 0.0])
    memory, _ = flown.command(memory, action, level, jnp.zeros(3))
    _, command = flown.command(memory, action, level, jnp.zeros(3))
    wanted = [6 * 10 * output + 3 * 10 * output * 0.002 * tick for tick in (1, 2)]
    torque = 250 * wanted[1] + 500 * sum(wanted) * 0.002 + 2.5 * (wanted[1] - wanted[0]) / 0.002
    counts = np.clip(
        45000 + np.trunc(min(torque, 32767.0) / 2) * np.array([-1, -1, 1, 1]), 0, 60000
    )
    np.testing.assert_allclose(np.asarray(command) * 60000, counts, atol=2)


def test_yaw_rate_is_the_rate_pids_own_set_point() -> None:
    """The counts of the first tick: 120 and 16.7 times 60 deg/s, and all thrust asked for beside
    it."""
    flown = controller_as_flown(interface.attitude_rate())
    level = Measurement(jnp.zeros(3), jnp.zeros(3), jnp.array([0.0, 0.0, 0.0, 1.0]), jnp.zeros(3))
    _, command = flown.command(flown.init(), jnp.array([0.0, 0.0, 0.0, 1.0]), level, jnp.zeros(3))
    yaw = np.trunc(120 * 60 + 16.7 * 60 * 0.002)
    np.testing.assert_allclose(
        np.asarray(command) * 60000, 30000 + yaw * np.array([-1, 1, -1, 1]), atol=0.01
    )


def test_no_thrust_stops_all_motors_and_empties_the_rate_pids() -> None:
    flown = controller_as_flown(interface.attitude_rate())
    level = Measurement(jnp.zeros(3), jnp.zeros(3), jnp.array([0.0, 0.0, 0.0, 1.0]), jnp.zeros(3))
    turns = jnp.array([0.0, 0.5, -0.5, 1.0])
    memory, begun = flown.command(flown.init(), turns, level, jnp.zeros(3))
    memory, stopped = flown.command(memory, turns.at[0].set(-1.0), level, jnp.zeros(3))
    assert np.abs(begun - 0.5).min() > 0.1
    assert (np.asarray(stopped) == 0.0).all()
    _, again = flown.command(memory, turns, level, jnp.zeros(3))
    np.testing.assert_array_equal(again, begun)
