"""The plant: floor, latency, battery, sensors, and that it is the reality of the same drone."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maidenflight.parameters import noiseless
from maidenflight.simulator.physics import battery, dynamics
from maidenflight.simulator.realities.virtual_drone import virtual_drone
from maidenflight.simulator.tasks.tasks import STANDING_HEIGHT_M
from maidenflight_plant import running_plant as plant

pytestmark = pytest.mark.slow

DRONE = replace(virtual_drone(7), thrust_law=battery.PLUS)
STILL = replace(DRONE, parameters=noiseless(DRONE.parameters))
GRAVITY = float(DRONE.parameters.gravity)


def flight(drone, pwm, steps, seed=0):
    """States and readings of a flight with constant PWM, the first before any step."""
    running = plant.RunningPlant(drone, seed, 60000.0)
    states, seen = [running.state], [running.readings]
    for _ in range(steps):
        seen.append(running.step(np.full(4, pwm, np.float32)))
        states.append(running.state)
    return jax.tree.map(lambda *parts: np.stack(parts), *states), np.stack(seen)


def test_with_motors_off_it_stands_on_the_floor_and_feels_its_weight():
    state, seen = flight(STILL, 0, 60)
    assert np.all(state.position[:, 2] == np.float32(STANDING_HEIGHT_M))
    assert not state.velocity.any()
    assert not state.rotor_speed.any()
    np.testing.assert_allclose(seen[:, 3:6].mean(axis=0), [0, 0, GRAVITY], atol=0.15)
    np.testing.assert_allclose(seen[:, 13].mean(), STANDING_HEIGHT_M, atol=0.003)
    np.testing.assert_allclose(seen[:, 9:13], np.tile([0, 0, 0, 1], (61, 1)), atol=1e-6)


def test_motors_turn_after_the_latency_and_the_battery_sags_at_once():
    state, seen = flight(STILL, 45000, 60)
    first = int(np.argmax(state.rotor_speed[:, 0] > 0))
    late = float(DRONE.parameters.latency)
    assert late * 1000 <= first <= late * 1000 + 1.01
    ratio = np.floor(45000 / 256) / 256
    sag = float(DRONE.parameters.battery_resistance) * ratio
    assert seen[0, 16] - seen[1, 16] == pytest.approx(sag, abs=1e-4)


def test_a_steady_thrust_is_the_law_s_at_the_voltage_of_the_moment():
    state, seen = flight(STILL, 60000, 400)
    ratio = np.array([np.floor(60000 / 256) / 256], np.float32)
    command = battery.thrust_command(
        ratio, seen[-1, 16], battery.Supply(battery.PLUS, 60000.0, battery=True)
    )
    np.testing.assert_allclose(state.rotor_speed[-1], np.sqrt(command[0]), rtol=0.01)
    assert state.position[-1, 2] > 0.1
    # In free flight an accelerometer feels thrust and drag alone, here behind its filter.
    forces = dynamics.rotor_forces(jnp.asarray(state.rotor_speed[-20]), DRONE.parameters)
    lift = float(forces.sum() / DRONE.parameters.mass)
    drag = float(DRONE.parameters.drag[2]) * state.velocity[-20, 2]
    assert seen[-12, 5] == pytest.approx(lift - drag, rel=0.06)


def test_pose_range_and_flow_are_new_every_10_ms():
    _, seen = flight(DRONE, 30000, 60)
    fresh = np.any(np.diff(seen[:, 6:16], axis=0) != 0, axis=1)
    np.testing.assert_array_equal(np.flatnonzero(fresh) + 1, np.arange(10, 61, 10))
    assert np.all(np.any(np.diff(seen[:, :6], axis=0) != 0, axis=1))


def test_the_same_seed_is_the_same_flight_and_another_is_not():
    first, again = (plant.RunningPlant(DRONE, seed, 60000.0) for seed in (3, 3))
    other = plant.RunningPlant(DRONE, 4, 60000.0)
    pwm = np.full(4, 40000, np.float32)
    for _ in range(12):
        one, two, three = (each.step(pwm) for each in (first, again, other))
        assert one.tobytes() == two.tobytes()
        assert one.tobytes() != three.tobytes()


def test_a_drone_without_a_law_takes_pwm_as_its_thrust_command():
    state, seen = flight(replace(STILL, thrust_law=None), 30000, 700)
    np.testing.assert_allclose(state.rotor_speed[-1], np.sqrt(30000 / 60000), rtol=1e-3)
    assert np.all(seen[:, 16] == seen[0, 16])


def test_flow_over_the_ground_is_velocity_over_height_minus_rotation():
    made, parameters = plant.plant_of(STILL, 60000.0)
    before = plant.begin(made, parameters, jax.random.key(0))
    moving = before.state._replace(
        position=jnp.array([0.0, 0.0, 1.0]),
        velocity=jnp.array([0.5, -0.2, 0.0]),
        body_rates=jnp.array([0.3, 0.1, 0.0]),
        rotor_speed=jnp.full(4, 0.77),
    )
    quiet = jnp.zeros(plant.draw(jax.random.key(0), 1).shape[1])
    after = plant.step(
        made,
        before._replace(state=moving),
        jnp.full(4, 40000.0),
        parameters,
        quiet,
        True,
    )
    np.testing.assert_allclose(after.readings.flow, [0.5 - 0.1, -0.2 + 0.3], atol=0.02)
    assert float(after.readings.range) == pytest.approx(1.0, abs=0.01)
