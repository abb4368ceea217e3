"""Platforms: whose gains fly a drone, from its file to the commands of its motors."""

import jax.numpy as jnp
import numpy as np
import pytest

from maidenflight.errors import InputError
from maidenflight.parameters import PLATFORMS, crazyflie, drone, from_toml, replace, to_toml
from maidenflight.simulator.controllers import control, mellinger
from maidenflight.simulator.controllers.mellinger import mellinger as mellinger_controller
from maidenflight.simulator.controllers.position_pid import position_pid
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.realities.virtual_drone import virtual_drone

BRUSHLESS = "crazyflie_brushless"
LEVEL = Measurement(jnp.zeros(3), jnp.zeros(3), jnp.array([0.0, 0.0, 0.0, 1.0]), jnp.zeros(3))


def roll_of(structure: control.Controller) -> float:
    """Difference of the motors' commands, left less right, of a first action for a roll rate."""
    action = jnp.array([0.2, 0.5, 0.0, 0.0])
    _, motors = structure.command(structure.init(), action, LEVEL, jnp.zeros(3))
    return float(motors[3] - motors[0])


def test_a_brushless_drone_is_flown_with_its_own_gains_by_all_that_flies_the_firmware():
    named = replace(drone(BRUSHLESS), time_step=0.002)
    usual = control.attitude_rate()
    env = Environment.matching(named, controller=usual)
    # (200 + 400 dt) / (250 + 500 dt) of the first tick.
    assert roll_of(env.controller) / roll_of(usual) == pytest.approx(0.8, rel=1e-3)
    for make in (control.attitude, position_pid, mellinger_controller):
        assert make().on(named) != make()
        assert make().on(crazyflie()) == make()
    assert control.pwm().on(named) == control.pwm()


def test_the_platform_decides_what_mellinger_takes_for_the_weight():
    target = mellinger.FullState(*[jnp.zeros(3)] * 4)
    hovers = [
        mellinger.tick(mellinger.switched_on(), target, LEVEL, platform=PLATFORMS[name])[1][0]
        for name in ("crazyflie", BRUSHLESS)
    ]
    np.testing.assert_allclose(hovers[1] / hovers[0], 39.3 / 27.0, rtol=1e-4)


def test_a_drone_file_names_its_platform_and_drones_drawn_about_it_have_it():
    named = drone(BRUSHLESS)
    text = to_toml(named, "mine")
    assert from_toml(text).platform == named.platform == BRUSHLESS
    assert virtual_drone(7, "far", from_toml(text)).parameters.platform == BRUSHLESS
    without = "\n".join(line for line in text.splitlines() if not line.startswith("platform"))
    assert from_toml(without).platform == "crazyflie"
    with pytest.raises(InputError, match="crazyflie_brushless"):
        from_toml(text.replace(f'"{BRUSHLESS}"', '"crazyfly"'))
