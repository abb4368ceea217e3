"""One-step errors against free fall by hand, and how they tell parameters apart."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from scipy.spatial.transform import Rotation

import planted
from maidenflight.flights.windows import LEAD_IN, Windows, windows
from maidenflight.identification.likelihood import one_step_errors
from maidenflight.identification.likelihood.observation import MOTORS
from maidenflight.identification.likelihood.one_step import LENGTH
from maidenflight.identification.likelihood.one_step_errors import COLUMNS, ORDER, errors
from maidenflight.identification.replay.open_loop import initial_delay_line
from maidenflight.parameters import QUANTITIES, crazyflie, noiseless, replace
from maidenflight.simulator.physics import dynamics, motion, rotations, sensors
from maidenflight.simulator.physics.dynamics import State
from maidenflight.simulator.physics.latency import DelayLine

TRUTH = planted.drone(1.9, 0.06, 0.012)
STEPS = 2
"""Physics steps a row, as many as the planted flights have."""


def cut(flights):
    return windows(flights, LENGTH, every=LENGTH)


@pytest.fixture(scope="module")
def flights():
    return planted.logs(TRUTH)


@pytest.mark.slow
def test_the_errors_of_a_noiseless_flight_vanish_at_the_truth_and_grow_away_from_it(flights):
    some, many = cut(flights), jax.jit(jax.vmap(partial(errors, steps=STEPS), (0, None)))

    def size(**changes):
        found = np.asarray(many(some, replace(TRUTH, **changes)))
        assert found.shape == (planted.FLIGHTS, LENGTH, 12)
        return np.sqrt(np.mean(found**2, axis=(0, 1)))[np.array(COLUMNS)]

    assert (size() < [5e-6] * 3 + [1e-4] * 3).all(), "m/s, rad/s"
    for name, near, far in (
        ("thrust_to_weight", 1.91, 1.95),
        ("motor_time_constant", 0.062, 0.07),
        ("latency", 0.0125, 0.015),
        ("inertia_x", 1.35e-5, 1.5e-5),
    ):
        assert size(**{name: far}).max() > 2 * size(**{name: near}).max() > 10 * size().max(), name


@pytest.mark.slow
def test_what_turns_move_of_an_estimate_is_foreseen(flights):
    """Estimates as `sensors.add_drift` says, of rocking drones: errors come from `turn_drift`
    alone, and vanish with it."""

    def moved(flight):
        p, q, _ = flight.body_rates.astype(float).T
        turned = Rotation.from_euler("ZYX", flight.attitude[:, ::-1].astype(float))
        up, change = (
            turned.apply(axis) * [1, 1, 0] for axis in ([0, 0, 1], np.stack([q, -p, 0 * p], axis=1))
        )
        late = 0.2 * (up + sensors.TURN_LEAD * change)
        return dataclasses.replace(
            flight,
            position=flight.position + late + np.cumsum(late, axis=0) * flight.period,
            velocity=flight.velocity + late / sensors.DRIFT_TIME,
        )

    some, many = (
        cut([moved(one) for one in flights]),
        jax.jit(jax.vmap(partial(errors, steps=STEPS), (0, None))),
    )
    told, untold = (
        np.abs(many(some, replace(TRUTH, turn_drift=drift)))[..., [0, 1, 3, 4]].mean(axis=(0, 1))
        for drift in (0.2, 0.0)
    )
    assert (untold > 5e-4).all(), "m, m/s"
    assert (told < 0.05 * untold).all()


@pytest.mark.slow
@pytest.mark.parametrize("steps", [2, 5, 10])
def test_latencies_of_several_rows_are_told_apart_however_fine_the_steps(steps, flights):
    """A delay line that is sized by the steps and not by the rows forgets what is 45 ms old."""
    some = Windows(*(array[0] for array in cut(flights)))
    foreseen = jax.jit(partial(errors, steps=steps))
    found = [
        np.asarray(foreseen(some, replace(TRUTH, latency=delay, time_step=0.01 / steps)))
        for delay in (0.030, 0.038, 0.046)
    ]
    turned = [
        np.abs(late[:, 9:11] - later[:, 9:11]).max()
        for late, later in zip(found[:-1], found[1:], strict=True)
    ]
    assert min(turned) > 0.02, "rad/s"


@pytest.mark.slow
def test_the_errors_of_a_fall_are_what_is_left_by_hand():
    """With its rotors at rest and a round body a row is foreseen by a parabola and a turn at a
    constant rate, whatever it was before."""
    generator = np.random.default_rng(3)
    rows = np.cumsum(generator.normal(0, 0.02, (LENGTH + 1, 12)), axis=0).astype(np.float32)
    start, measured = rows[0], rows[1:]
    falling = Windows(
        position=start[:3],
        velocity=start[3:6],
        quaternion=Rotation.from_euler("ZYX", start[8:5:-1]).as_quat().astype(np.float32),
        body_rates=start[9:],
        command=np.zeros((200, 4), np.float32),
        measured=measured,
        segment=np.array(0),
    )
    drone = replace(noiseless(crazyflie()), inertia=(1e-5, 1e-5, 1e-5))
    found = np.asarray(jax.jit(partial(errors, steps=STEPS))(falling, drone))
    before, weight = rows[:-1].astype(float), np.array([0, 0, -9.81])
    np.testing.assert_allclose(
        found[:, :3],
        measured[:, :3] - before[:, :3] - 0.01 * before[:, 3:6] - 0.01**2 / 2 * weight,
        atol=2e-6,
    )
    np.testing.assert_allclose(
        found[:, 3:6], measured[:, 3:6] - before[:, 3:6] - 0.01 * weight, atol=2e-6
    )
    ahead = Rotation.from_euler("ZYX", before[:, 8:5:-1]) * Rotation.from_rotvec(
        0.01 * before[:, 9:]
    )
    np.testing.assert_allclose(
        found[:, 6:9], measured[:, 6:9] - ahead.as_euler("ZYX")[:, ::-1], atol=2e-6
    )
    np.testing.assert_allclose(found[:, 9:], measured[:, 9:] - before[:, 9:], atol=2e-6)


@pytest.mark.slow
def test_rows_of_several_commands_are_foreseen_as_rows_of_one_are(flights):
    """A command that is written down five times, a fifth as long each, is the same command."""
    one = Windows(*(array[0] for array in cut(planted.with_noise(flights, seed=1))))
    often = one._replace(command=np.repeat(one.command, 5, axis=0))
    # A latency by which all steps are of one length.
    drone = replace(TRUTH, latency=0.005, time_step=0.001)
    plain = jax.jit(partial(errors, steps=10))(one, drone)
    strided = jax.jit(partial(errors, steps=2, stride=5))(often, drone)
    np.testing.assert_allclose(np.asarray(strided), np.asarray(plain), atol=2e-6)


@pytest.mark.slow
def test_rows_side_by_side_are_foreseen_as_one_after_the_other():
    """Each from the measured row before it, its rotors as the commands until then left them."""
    window, drone = some_window(), replace(TRUTH, time_step=0.01 / STEPS)
    given, places, speed = initial_delay_line(window, drone, STEPS)
    first = np.concatenate([window.position, window.velocity, [0, 0, 0], window.body_rates])
    before = np.concatenate([first[None], window.measured[:-1]]).astype(np.float32)

    def advance(speed, row):
        place, (position, velocity, attitude, rates) = row[0], jnp.split(row[1], 4)
        state = State(position, velocity, rotations.from_attitude(attitude), rates, speed)
        line = DelayLine(given, place)
        after = motion.drive(dynamics.midpoint, state, line, STEPS, drone)
        attitude = rotations.to_attitude(after.quaternion)
        ahead = jnp.concatenate([after.position, after.velocity, attitude, after.body_rates])
        return after.rotor_speed, ahead

    ahead = lax.scan(advance, speed, (places, jnp.asarray(before)))[1]
    wrong = jax.jit(partial(errors, steps=STEPS))(window, drone)
    np.testing.assert_allclose(wrong, window.measured - ahead, atol=2e-5)


@pytest.mark.slow
def test_rotors_depend_on_the_parameters_that_are_said_and_on_no_other():
    slopes = jax.jacfwd(lambda drone: one_step_errors._speeds(some_window(), drone, STEPS, 1))(
        jax.tree.map(jnp.asarray, replace(TRUTH, motor_coasting=0.1, time_step=0.01 / STEPS))
    )
    depends = {name for name in QUANTITIES if np.any(getattr(slopes, name))}
    assert depends - {"time_step"} == set(MOTORS)


def test_products_of_late_errors_are_those_of_all_their_rows():
    """Of random errors with a last row that dwarfs all others."""
    wrong = np.random.default_rng(3).normal(0, 1, (3, 2, LENGTH)).astype(np.float32)
    wrong[..., -1] = 1e4
    rows = np.arange(ORDER, LENGTH)
    late = np.stack([wrong[..., rows - lag] for lag in range(ORDER + 1)], axis=2).astype(float)
    expected = np.einsum("wcit,wcjt->wcij", late, late)
    np.testing.assert_allclose(one_step_errors.products(wrong), expected, rtol=1e-9, atol=1e-6)


def some_window() -> Windows:
    """A window of small motions and lively commands."""
    rng = np.random.default_rng(5)
    rows = np.cumsum(rng.normal(0, 0.02, (LENGTH + 1, 12)), axis=0).astype(np.float32)
    start = rows[0].copy()
    start[6:9] = 0.0
    return Windows(
        position=start[:3],
        velocity=start[3:6],
        quaternion=np.array([0, 0, 0, 1], np.float32),
        body_rates=start[9:],
        command=rng.uniform(0.1, 0.9, (LEAD_IN + LENGTH, 4)).astype(np.float32),
        measured=rows[1:],
        segment=np.int32(0),  # type: ignore[arg-type]
    )
