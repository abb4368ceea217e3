"""The Mellinger controller: what it does about each axis, and that it flies."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maidenflight.parameters import crazyflie, noiseless, replace
from maidenflight.simulator import environment
from maidenflight.simulator.controllers import mellinger
from maidenflight.simulator.controllers.mellinger import FullState, Memory
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics import dynamics, rotations
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.stepping import rollout
from maidenflight.simulator.tasks import tasks, trajectories

STILL, UP = jnp.zeros(3), jnp.array([0.0, 0.0, 1.0])
ASKED = FullState(UP, STILL, STILL, STILL)
LEVEL = Measurement(UP, STILL, jnp.array([0.0, 0.0, 0.0, 1.0]), STILL)
HOVER = 132000 * 0.027 * 9.81
QUICK = replace(noiseless(crazyflie()), latency=0.005, time_step=0.002, thrust_to_weight=1.7)
ticked = jax.jit(mellinger.tick)


def motors(state: Measurement = LEVEL, target: FullState = ASKED) -> np.ndarray:
    """Commands [counts] of the second of two equal ticks, the first being special."""
    memory, _ = ticked(mellinger.switched_on(), target, state)
    return np.asarray(ticked(memory, target, state)[1])


def torque(counts: np.ndarray) -> np.ndarray:
    """Signs about x, y, z: left over right, rear over front, positive reaction over negative."""
    x, y = np.array([-1, -1, 1, 1]), np.array([-1, 1, 1, -1])
    signs = np.array([x, y, np.asarray(crazyflie().rotor_direction)]) @ counts
    return np.where(np.abs(signs) > 2.0, np.sign(signs), 0.0)


def test_where_it_should_be_all_motors_carry_its_weight() -> None:
    np.testing.assert_allclose(motors(), HOVER, atol=1.0)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_it_turns_against_a_rotation_and_against_a_rate(axis: int) -> None:
    turned = rotations.from_attitude(0.1 * jnp.eye(3)[axis])
    against = -np.eye(3)[axis]
    np.testing.assert_array_equal(torque(motors(LEVEL._replace(quaternion=turned))), against)
    spinning = LEVEL._replace(body_rates=0.1 * jnp.eye(3)[axis])
    np.testing.assert_array_equal(torque(motors(spinning)), against)


def test_gains_are_those_of_the_firmware() -> None:
    """2 sin(angle) times 70,000 counts for roll; half of the torque on each motor."""
    rolled = LEVEL._replace(quaternion=rotations.from_attitude(jnp.array([0.05, 0.0, 0.0])))
    by = motors(rolled)
    assert by[0] - by[3] == pytest.approx(2 * 0.05 * 70000, rel=1e-2)
    spinning = LEVEL._replace(body_rates=jnp.array([0.0, 0.0, 0.2]))
    by = motors(spinning)
    assert abs(by[0] - by[1]) == pytest.approx(2 * 12000 * 0.2, rel=1e-3)
    far = motors(target=ASKED._replace(position=UP + jnp.array([0.0, 0.0, 0.1])))
    assert far.mean() - HOVER == pytest.approx(132000 * 0.125, rel=1e-2)


@pytest.mark.parametrize("name", ["position", "velocity", "acceleration"])
def test_it_leans_towards_what_is_asked(name: str) -> None:
    """Forward is nose down (positive pitch), left is left side down (negative roll)."""
    for axis, lean in ((0, [0, 1, 0]), (1, [-1, 0, 0])):
        asked = getattr(ASKED, name) + 0.2 * jnp.eye(3)[axis]
        np.testing.assert_array_equal(torque(motors(target=ASKED._replace(**{name: asked}))), lean)
    raised = motors(target=ASKED._replace(**{name: getattr(ASKED, name) + 0.2 * jnp.eye(3)[2]}))
    assert (raised > HOVER + 100).all()


def test_body_rates_of_a_reference_turn_the_force_along_with_it() -> None:
    """Differential flatness: the desired axes, differentiated, turn at the rates but for yaw."""
    curve = trajectories.circle(1.0, 2.0)

    def axis(time: jax.Array) -> jax.Array:
        force = jax.jvp(
            lambda t: jax.jvp(curve, (t,), (jnp.ones(()),))[1], (time,), (jnp.ones(()),)
        )[1]
        return mellinger.desired_axes(force + jnp.array([0.0, 0.0, 9.81]))[2]

    time = jnp.float32(0.7)
    found = mellinger.full_state(curve, time, curve(time))
    x, y, z = mellinger.desired_axes(found.acceleration + jnp.array([0.0, 0.0, 9.81]))
    _, turning = jax.jvp(axis, (time,), (jnp.ones(()),))
    world = found.body_rates[0] * x + found.body_rates[1] * y
    np.testing.assert_allclose(jnp.cross(world, z), turning, atol=1e-4)
    later, earlier = (np.asarray(curve(time + d)) for d in (0.01, -0.01))
    np.testing.assert_allclose(found.velocity, (later - earlier) / 0.02, atol=1e-3)


def test_without_thrust_the_motors_stand_still_and_it_forgets() -> None:
    memory, _ = ticked(mellinger.switched_on(), ASKED, LEVEL)
    upside_down = LEVEL._replace(quaternion=jnp.array([1.0, 0.0, 0.0, 0.0]), position=UP * 0.9)
    memory, counts = ticked(memory, ASKED, upside_down)
    assert isinstance(memory, Memory)
    np.testing.assert_array_equal(counts, 0.0)
    np.testing.assert_array_equal(memory.position, 0.0)


@partial(jax.jit, static_argnums=(0, 1))
def farthest(full: bool, seconds: int) -> jax.Array:
    """Distances [m] from the paper's circle at every tick."""
    task = tasks.paper_circle()
    controller = mellinger.mellinger(task.reference if full else None)
    env = Environment(task=task, controller=controller, steps_per_command=1)
    start = dynamics.at_hover(task.reference(jnp.float32(0.0)), QUICK)
    begun = environment.begin(env, start, jnp.float32(0.0), QUICK, jax.random.key(0))
    _, (flown, _) = rollout(
        env, lambda _: jnp.zeros(4), begun, QUICK, jax.random.key(1), 500 * seconds
    )
    times = (jnp.arange(500 * seconds) + 1) / 500
    return jnp.linalg.norm(flown.state.position - jax.vmap(task.reference)(times), axis=1)


@pytest.mark.slow
def test_it_flies_the_circle_and_closer_where_it_knows_all_of_it() -> None:
    full, alone = (np.asarray(farthest(known, 6))[1500:].mean() for known in (True, False))
    assert full < 0.05
    assert full < 0.5 * alone
    assert alone < 0.3
