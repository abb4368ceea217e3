"""Virtual drones: repeatable, different from each other, physical, and flyable by the firmware's
own controller."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maidenflight.errors import InputError
from maidenflight.parameters import QUANTITIES, check, crazyflie, replace
from maidenflight.simulator import environment
from maidenflight.simulator.controllers import control
from maidenflight.simulator.controllers.position_pid import position_pid
from maidenflight.simulator.physics import dynamics, sensors
from maidenflight.simulator.physics.battery import FIRMWARE_2021, PLUS
from maidenflight.simulator.realities.virtual_drone import (
    FAR_RANGES,
    RANGES,
    VARIANTS,
    virtual_drone,
)
from maidenflight.simulator.stepping import rollout
from maidenflight.simulator.tasks import tasks

SEEDS = range(8)


def test_the_same_seed_is_the_same_drone():
    first, second = virtual_drone(3), virtual_drone(3)
    assert first.name == second.name == "virtual:3"
    jax.tree.map(np.testing.assert_array_equal, first.parameters, second.parameters)


@pytest.mark.parametrize("name", [*RANGES, "inertia", "drag", "torque_to_thrust"])
def test_different_seeds_hide_different_constants(name):
    values = np.array([getattr(virtual_drone(seed).parameters, name) for seed in SEEDS])
    assert len(np.unique(values, axis=0)) == len(SEEDS)


@pytest.mark.parametrize("seed", [*range(30), 2**40])
def test_every_virtual_drone_is_physical_and_within_its_spread(seed):
    parameters = check(virtual_drone(seed).parameters)
    for name, (low, high) in RANGES.items():
        assert np.float32(low) <= getattr(parameters, name) <= np.float32(high), name
    assert parameters.time_step == np.float32(0.001)
    assert all(np.asarray(getattr(parameters, name)).dtype == np.float32 for name in QUANTITIES)


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("seed", range(6))
def test_drones_about_another_differ_from_it_as_drawn_crazyflies_from_theirs(variant, seed):
    centre = replace(
        crazyflie(), thrust_to_weight=3.0, motor_time_constant=0.03, mass=0.5, inertia=(3e-3,) * 3
    )
    drone = virtual_drone(seed, variant, centre)
    usual = virtual_drone(seed, variant)
    share = 0.9 if variant == "far" else 1.0
    assert 1.55 / 1.85 * 3.0 * share < drone.parameters.thrust_to_weight < 1.85 / 1.55 * 3.0
    assert drone.parameters.mass == pytest.approx(0.5, rel=0.04)
    np.testing.assert_allclose(
        drone.parameters.inertia / 3e-3, usual.parameters.inertia / crazyflie().inertia, rtol=1e-5
    )
    assert drone.parameters.position_walk == 0.0
    assert (drone.thrust_law, usual.thrust_law) == (None, FIRMWARE_2021)
    check(drone.parameters)


def test_a_crazyflie_about_which_one_is_drawn_keeps_what_was_identified():
    centre = replace(crazyflie(), motor_coasting=0.12, drag=(0.4, 0.2, 0.0), velocity_walk=0.08)
    drone = virtual_drone(5, "virtual", centre)
    assert drone.parameters.velocity_walk == np.float32(0.08)
    assert sensors.drifts(drone.parameters)
    assert not sensors.drifts(virtual_drone(5).parameters)
    assert drone.thrust_law == FIRMWARE_2021
    assert virtual_drone(5, "virtual", centre, PLUS).thrust_law == PLUS
    assert drone.parameters.motor_coasting == np.float32(0.12)
    assert drone.parameters.drag[0] / drone.parameters.drag[1] == pytest.approx(
        2 * float(np.divide(*virtual_drone(5).parameters.drag[:2])), rel=1e-5
    )
    assert drone.parameters.drag[2] > 0


def test_a_negative_seed_and_an_unknown_kind_are_refused():
    with pytest.raises(InputError, match="seed of 0 or more"):
        virtual_drone(-1)
    with pytest.raises(InputError, match="near, virtual, far"):
        virtual_drone(1, "farther")


@pytest.mark.parametrize("seed", range(10))
def test_a_near_drone_is_of_the_papers_model_with_other_numbers(seed):
    near, paper, virtual = (
        virtual_drone(seed, "near").parameters,
        crazyflie(),
        virtual_drone(seed).parameters,
    )
    lacking = (
        "spin_down_ratio",
        "drag",
        "estimator_delay",
        "gyro_time_constant",
        "battery_resistance",
        "battery_discharge",
        "flapping_moment",
    )
    for name in (*lacking, "rotor_momentum", "torque_bias"):
        np.testing.assert_array_equal(getattr(near, name), getattr(paper, name), err_msg=name)
    for name in ("thrust_to_weight", "latency", "mass", "inertia"):
        np.testing.assert_array_equal(getattr(near, name), getattr(virtual, name), err_msg=name)
    up, down = virtual.motor_time_constant, virtual.motor_time_constant * virtual.spin_down_ratio
    np.testing.assert_allclose(near.motor_time_constant, (up + down) / 2, rtol=1e-6)


@pytest.mark.parametrize("seed", range(10))
def test_a_far_drone_has_what_flights_of_the_authors_drone_tell(seed):
    far, virtual = check(virtual_drone(seed, "far").parameters), virtual_drone(seed).parameters
    for name, (low, high) in FAR_RANGES.items():
        value = np.asarray(getattr(far, name))
        assert np.all((np.float32(low) <= value) & (value <= np.float32(high))), name
    assert np.all(far.torque_bias != 0)
    for name in ("drag", "inertia", "latency", "estimator_delay", "battery_resistance"):
        np.testing.assert_array_equal(getattr(far, name), getattr(virtual, name), err_msg=name)
    assert len({virtual_drone(seed, kind).name for kind in VARIANTS}) == len(VARIANTS)


def test_a_virtual_drone_has_effects_that_the_papers_model_lacks():
    drone = virtual_drone(0)
    env = drone.environment(tasks.circle(), control.pwm())
    assert env.integrator is dynamics.rk4
    assert env.battery
    assert env.estimator_memory * 0.01 > QUANTITIES["estimator_delay"].lower
    for name in (
        "drag",
        "spin_down_ratio",
        "estimator_delay",
        "battery_resistance",
        "battery_discharge",
    ):
        assert np.all(getattr(drone.parameters, name) > getattr(crazyflie(), name)), name


@pytest.mark.parametrize("controller", [control.pwm(), position_pid()])
def test_commands_and_actions_hold_for_their_periods(controller):
    drone = virtual_drone(0)
    env = drone.environment(tasks.circle(), controller)
    np.testing.assert_allclose(
        env.command_period(drone.parameters), 1 / controller.command_rate, rtol=1e-6
    )
    np.testing.assert_allclose(
        env.control_period(drone.parameters), 1 / controller.interface.rate, rtol=1e-6
    )


@pytest.mark.slow
def test_the_firmwares_pid_flies_the_circle_on_every_virtual_drone():
    drones = [virtual_drone(seed, kind) for kind in VARIANTS for seed in SEEDS]
    env = drones[-1].environment(tasks.circle(), position_pid())

    def fly(parameters, key):
        start = dynamics.at_hover(jnp.array([0.0, 0.0, 1.0]), parameters)
        env_state = environment.begin(env, start, jnp.float32(0.0), parameters, key)
        _, (flown, step_result) = rollout(
            env, lambda _: jnp.zeros(4), env_state, parameters, key, 3000
        )
        return flown.state, step_result.setpoint

    batch = jax.tree.map(lambda *leaves: np.stack(leaves), *(drone.parameters for drone in drones))
    state, setpoint = jax.jit(jax.vmap(fly))(
        batch, jax.random.split(jax.random.key(0), len(drones))
    )
    tilt = np.degrees(
        np.arccos(
            np.asarray(
                jax.jit(jax.vmap(jax.vmap(lambda q: 1 - 2 * (q[0] ** 2 + q[1] ** 2))))(
                    state.quaternion
                )
            )
        )
    )
    height, distance = (
        np.asarray(state.position[..., 2]),
        np.linalg.norm(state.position - setpoint, axis=-1),
    )
    assert np.all((height > 0.7) & (height < 1.3))
    assert np.all(tilt < 30)
    assert np.all(distance < 0.5)
    assert np.all(np.ptp(state.position[:, 1500:, 1], axis=1) > 0.35), (
        "it flies the circle instead of hovering"
    )
