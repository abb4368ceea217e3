"""PyBullet against our own rigid body: the same flight, the same laws, and its own habits as
documented."""

import subprocess
import sys
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from arrays import float32, float64
from maidenflight.errors import InputError
from maidenflight.experiments.drones import find_reality
from maidenflight.experiments.transfer import transfer
from maidenflight.flying import recording
from maidenflight.integrations.simulators import bullet
from maidenflight.integrations.simulators.bullet import DAMPING, Bullet, bullet_drone
from maidenflight.parameters import crazyflie, replace
from maidenflight.policy import untrained_policy
from maidenflight.simulator import environment
from maidenflight.simulator.controllers import control
from maidenflight.simulator.physics import dynamics, rotations
from maidenflight.simulator.physics.dynamics import State
from maidenflight.simulator.realities.virtual_drone import virtual_drone
from maidenflight.simulator.stepping import rollout
from maidenflight.simulator.tasks import tasks

UNEQUAL = replace(
    crazyflie(), inertia=(1.33e-5, 1.6e-5, 2.64e-5), drag=(0.3, 0.2, 0.1), spin_down_ratio=1.4
)
OFF = (0.0, 0.0, 0.0, 0.0)
PIECES = [
    *[(0.58, 0.63, 0.88, 0.88)] * 4,
    *[(0.88, 0.83, 0.53, 0.58)] * 5,
    *[(0.53, 0.83, 0.83, 0.48)] * 4,
    *[(0.83, 0.58, 0.63, 0.88)] * 4,
    *[(0.48, 0.83, 0.48, 0.88)] * 3,
    *[(0.83, 0.68, 0.83, 0.73)] * 5,
]
"""Rotor speed commands of 40 ms each that throw the drone about for a second."""


@pytest.fixture(scope="module")
def pybullet():
    return pytest.importorskip(
        "pybullet",
        reason="PyBullet is not installed (extra [pybullet]; it has wheels for Python 3.11 on "
        "Linux only)",
    )


def drone(velocity=(0, 0, 0), body_rates=(0, 0, 0), rotor_speed=OFF, quaternion=(0, 0, 0, 1)):
    return State(*map(float64, ((0, 0, 1), velocity, quaternion, body_rates, rotor_speed)))


def every(seconds, parameters):
    return replace(parameters, time_step=np.asarray(seconds))


def held(command, seconds, steps):
    """Commands and parameters of a second of flight with one command."""
    return np.broadcast_to(command, (steps, 4)), every(seconds, UNEQUAL)


THROWN = drone(velocity=(0.5, -0.3, 0.2), rotor_speed=(0.76,) * 4)


def thrown(steps):
    """Commands and parameters of the wild flight."""
    return np.repeat(PIECES, steps // len(PIECES), axis=0), every(1 / steps, UNEQUAL)


@partial(jax.jit, static_argnums=0)
def _flight(integrator, state, commands, parameters):
    def one(state, command):
        state = integrator(state, command, parameters)
        return state, state

    return lax.scan(one, state, commands)[1]


def ours(integrator, state, commands, parameters):
    """The same flight by our own integrators in float64."""
    with jax.enable_x64(True):
        return jax.tree.map(
            np.asarray, _flight(integrator, *jax.tree.map(float64, (state, commands, parameters)))
        )


def apart(one, other):
    """Largest distance [m] and angle [deg] between two flights of one second, compared every 4
    ms."""
    one, other = (
        jax.tree.map(lambda leaf: leaf[len(leaf) // 250 - 1 :: len(leaf) // 250], flight)
        for flight in (one, other)
    )
    distance = np.linalg.norm(one.position - other.position, axis=1).max()
    chord = np.minimum(
        *(np.linalg.norm(one.quaternion + sign * other.quaternion, axis=1) for sign in (-1, 1))
    ).max()
    return np.array([distance, np.degrees(4 * np.arcsin(chord / 2))])


@pytest.fixture(scope="module")
def truth():
    """The wild flight by RK4 at 0.1 ms."""
    return ours(dynamics.rk4, THROWN, *thrown(10000))


def test_the_flight_of_the_comparison_is_wild(truth):
    assert np.min(1 - 2 * np.sum(truth.quaternion[:, :2] ** 2, axis=1)) < -0.9, "upside down"
    assert np.abs(truth.body_rates).max() > 15


@pytest.mark.slow
def test_bullet_tends_to_our_equations_at_first_order_and_meets_them_at_a_tenth_of_a_millisecond(
    pybullet, truth
):
    flights = {
        steps: Bullet().simulate(THROWN, *thrown(steps)) for steps in (250, 500, 1000, 2000, 10000)
    }
    errors = {steps: apart(flight, truth) for steps, flight in flights.items()}
    orders = np.log2([errors[steps] / errors[2 * steps] for steps in (250, 500, 1000)])
    np.testing.assert_allclose(orders, 1, atol=0.05)
    assert errors[10000][0] < 0.002
    assert errors[10000][1] < 0.2
    # Extrapolated to no step at all it is RK4.
    one, half = (
        flights[steps].position[steps // 250 - 1 :: steps // 250] for steps in (1000, 2000)
    )
    assert np.linalg.norm(2 * half - one - truth.position[39::40], axis=1).max() < 1e-4


FURTHER = {
    "flapping_moment": (1e-4, 2e-4),
    "rotational_damping": 2e-5,
    "rotor_momentum": 3e-5,
    "torque_bias": (2e-5, -3e-5, 1e-5),
}


def test_bullet_feels_the_torques_that_the_papers_model_lacks_as_our_equations_do(pybullet, truth):
    """All at once, in wind, of which each alone would be missed."""

    def flown(fly, steps, names=FURTHER):
        commands, parameters = thrown(steps)
        further = {name: FURTHER[name] for name in names}
        return fly(THROWN, commands, replace(parameters, **further, wind=(1.0, -2.0, 0.5)))

    rk4 = partial(ours, dynamics.rk4)
    expected = flown(rk4, 2000)
    for name in FURTHER:
        assert apart(flown(rk4, 2000, FURTHER.keys() - {name}), expected)[1] > 2, name
    errors = [apart(flown(Bullet().simulate, steps), expected) for steps in (1000, 2000)]
    np.testing.assert_allclose(errors[0] / errors[1], 2, atol=0.1)
    assert errors[1][0] < 0.01
    assert errors[1][1] < 1


@pytest.mark.slow
def test_bullet_and_semi_implicit_euler_differ_at_second_order_by_how_they_turn(pybullet):
    errors = [
        apart(
            Bullet().simulate(THROWN, *thrown(steps)), ours(dynamics.euler, THROWN, *thrown(steps))
        )
        for steps in (250, 500, 1000)
    ]
    np.testing.assert_allclose(np.log2(np.divide(errors[:-1], errors[1:])), 2, atol=0.05)
    assert errors[1][0] < 0.002, "at 2 ms"
    assert errors[1][1] < 0.2


@pytest.mark.slow
def test_handing_the_state_over_in_float32_at_every_step_changes_little(pybullet):
    commands, parameters = thrown(2000)
    rounded = jax.tree.map(float32, (THROWN, commands, parameters))
    distance, angle = apart(
        jax.tree.map(float64, _flight(Bullet(), *rounded)),
        Bullet().simulate(THROWN, commands, parameters),
    )
    assert distance < 1e-4
    assert angle < 0.02


def test_the_body_is_the_drones(pybullet):
    Bullet().simulate(drone(), *held(OFF, 0.001, 1))
    world = bullet._world()
    read = pybullet.getDynamicsInfo(world.body, -1, **world.client)
    np.testing.assert_allclose([read[0], *read[2]], [UNEQUAL.mass, *UNEQUAL.inertia], rtol=1e-12)


def test_a_drone_with_its_motors_off_falls_freely(pybullet):
    commands, parameters = held(OFF, 0.001, 1000)
    end = Bullet().simulate(
        drone(velocity=(1, -2, 3)), commands, replace(parameters, drag=(0.0, 0.0, 0.0))
    )
    np.testing.assert_allclose(end.velocity[-1], [1, -2, 3 - 9.81], atol=1e-6)
    np.testing.assert_allclose(end.position[-1], [1, -2, 1 + 3 - 9.81 / 2 * 1.001], atol=1e-6)


def test_a_hovering_drone_stays_where_it_is_for_ten_seconds(pybullet):
    speed = np.full(4, 1 / np.sqrt(np.float64(UNEQUAL.thrust_to_weight)))
    yawed = (0, 0, np.sin(0.4), np.cos(0.4))
    end = Bullet().simulate(drone(rotor_speed=speed, quaternion=yawed), *held(speed, 0.005, 2000))
    np.testing.assert_allclose(end.position[-1], [0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(end.quaternion[-1], yawed, atol=1e-9)


def test_free_rotation_keeps_energy_and_momentum_and_turns_its_axis_by_the_gyroscopic_torque(
    pybullet,
):
    """Both drift at the first order of the step: Bullet takes the gyroscopic torque from the rates
    before it."""
    inertia, first = float64(UNEQUAL.inertia), drone(body_rates=(7, 5, -6))

    def drifts(steps):
        commands, parameters = held(OFF, 1 / steps, steps)
        after = Bullet().simulate(first, commands, parameters)
        quaternion, rates = after.quaternion[-1], after.body_rates[-1]
        before = inertia * first.body_rates
        np.testing.assert_allclose(
            rates, ours(dynamics.rk4, first, commands, parameters).body_rates[-1], atol=1e3 / steps
        )
        assert np.abs(rates - first.body_rates).max() > 2
        with jax.enable_x64(True):
            momentum = np.asarray(rotations.to_matrix(float64(quaternion))) @ (inertia * rates)
        energy = inertia @ rates**2 / (inertia @ first.body_rates**2) - 1
        return np.array([energy, np.linalg.norm(momentum - before) / np.linalg.norm(before)])

    coarse, fine = drifts(5000), drifts(10000)
    np.testing.assert_allclose(coarse / fine, 2, atol=0.05)
    np.testing.assert_allclose(fine, 0, atol=0.002)


@pytest.mark.parametrize(
    ("stronger", "axis", "what"),
    [
        ((2, 3), 0, "the left rotors roll the drone to its right"),
        ((1, 2), 1, "the back rotors push the nose down"),
        ((1, 3), 2, "the clockwise rotors 2 and 4 turn the drone counter-clockwise"),
    ],
)
def test_bullets_lever_arms_give_the_papers_torque(pybullet, stronger, axis, what):
    """Lying on its side, so that a torque about a world axis would be noticed."""
    speed = np.full(4, 0.7)
    speed[list(stronger)] = 0.8
    side = drone(rotor_speed=speed, quaternion=(np.sqrt(0.5), 0, 0, np.sqrt(0.5)))
    rates = Bullet().simulate(side, *held(speed, 0.001, 1)).body_rates[0]
    with jax.enable_x64(True):
        expected = 0.001 * np.asarray(
            dynamics.angular_acceleration(*jax.tree.map(float64, (side, np.zeros(4), UNEQUAL)))
        )
    np.testing.assert_allclose(rates, expected, rtol=1e-6, atol=1e-12)
    assert rates[axis] > 1e-3, what


def test_bullets_own_damping_is_what_we_say_it_is(pybullet):
    """Free fall of one second, and a turn of 1 rad/s about z, both also by hand."""
    commands, parameters = held(OFF, 0.0001, 10000)
    spun = drone(body_rates=(0, 0, 1))
    end = Bullet(DAMPING, DAMPING).simulate(
        spun, commands, replace(parameters, drag=(0.0, 0.0, 0.0))
    )
    most = np.sqrt((9.81 + DAMPING / 4) / DAMPING)
    by_hand = most * np.tanh(DAMPING * most + np.arctanh(0.5 / most)) - 0.5
    np.testing.assert_allclose(end.velocity[-1, 2], -by_hand, atol=2e-3)
    np.testing.assert_allclose(by_hand, 8.54, atol=0.01)
    left = np.exp(-DAMPING) / (2 - np.exp(-DAMPING))
    np.testing.assert_allclose(end.body_rates[-1, 2], left, atol=1e-5)
    np.testing.assert_allclose(left, 0.9245, atol=1e-4)


def test_a_body_that_is_told_nothing_of_damping_is_damped_like_that(pybullet):
    client = pybullet.connect(pybullet.DIRECT)
    try:
        body = pybullet.createMultiBody(baseMass=1.0, physicsClientId=client)
        pybullet.changeDynamics(
            body, -1, localInertiaDiagonal=UNEQUAL.inertia.tolist(), physicsClientId=client
        )
        pybullet.setTimeStep(0.001, physicsClientId=client)
        pybullet.resetBaseVelocity(body, (3, -2, 1), (1, -2, 3), physicsClientId=client)
        pybullet.stepSimulation(physicsClientId=client)
        untouched = np.concatenate(pybullet.getBaseVelocity(body, physicsClientId=client))
    finally:
        pybullet.disconnect(client)
    weightless = replace(
        UNEQUAL, gravity=np.asarray(0.0), drag=(0.0, 0.0, 0.0), time_step=np.asarray(0.001)
    )
    end = Bullet(DAMPING, DAMPING).simulate(
        drone((3, -2, 1), (1, -2, 3)), np.zeros((1, 4)), weightless
    )
    turned = rotations.to_matrix(float32(end.quaternion[0])) @ float32(end.body_rates[0])
    np.testing.assert_allclose(np.concatenate([end.velocity[0], turned]), untouched, rtol=1e-5)


def test_bullet_clips_velocities_at_a_hundred(pybullet):
    end = Bullet().simulate(drone((150, 0, 0), (0, 0, 150)), *held(OFF, 0.001, 1))
    np.testing.assert_allclose([end.velocity[0, 0], end.body_rates[0, 2]], 100)


def test_a_state_that_is_not_finite_stays_so_and_spoils_no_other(pybullet):
    parameters = every(np.float32(0.001), UNEQUAL)
    step = jax.jit(lambda state: Bullet()(state, jnp.zeros(4), parameters))
    good = jax.tree.map(float32, drone(velocity=(1, 2, 3)))
    before = step(good)
    assert np.isnan(step(good._replace(position=float32([np.nan] * 3))).position).all()
    jax.tree.map(np.testing.assert_array_equal, step(good), before)


@pytest.mark.slow
def test_two_drones_side_by_side_fly_as_one_by_one(pybullet):
    env = environment.Environment(integrator=Bullet(DAMPING, DAMPING))
    drones = [virtual_drone(1).parameters, virtual_drone(2).parameters]

    def fly(parameters, key):
        env_state = environment.reset(env, parameters, key)
        return rollout(env, lambda _: jnp.full(4, 0.3), env_state, parameters, key, 20)[1][0].state

    keys = jax.random.split(jax.random.key(0))
    together = jax.jit(jax.vmap(fly))(jax.tree.map(lambda *leaves: np.stack(leaves), *drones), keys)
    alone = jax.tree.map(lambda *leaves: np.stack(leaves), *map(jax.jit(fly), drones, keys))
    jax.tree.map(partial(np.testing.assert_allclose, atol=1e-5), together, alone)
    assert np.abs(together.position[0] - together.position[1]).max() > 1e-3


def test_the_same_settings_are_the_same_engine(pybullet):
    """So that an `Environment` with it compiles once."""
    assert hash(Bullet(DAMPING)) == hash(Bullet(DAMPING))
    assert environment.Environment(integrator=Bullet()) == environment.Environment(
        integrator=Bullet()
    )


def test_a_reality_in_pybullet_hides_the_same_constants(pybullet):
    drone, other = bullet_drone(7), virtual_drone(7)
    assert (drone.name, other.name) == ("pybullet:7", "virtual:7")
    assert find_reality("pybullet:7").name == drone.name
    jax.tree.map(np.testing.assert_array_equal, drone.parameters, other.parameters)
    env = drone.environment(tasks.circle(), control.pwm())
    assert env.integrator == Bullet(linear_damping=0.04, angular_damping=0.04)
    assert env.battery


@pytest.mark.slow
def test_the_firmwares_pid_flies_the_circle_in_pybullet(pybullet):
    (flight,) = recording.record(find_reality("pybullet:7"), jax.random.key(0), 1, 4.0, 0.0)
    assert flight.simulated == "pybullet:7"
    assert np.abs(flight.position[:, 2] - 1).max() < 0.3
    assert np.ptp(flight.position[200:, 1]) > 0.2


@pytest.mark.slow
def test_policies_transfer_to_pybullet(pybullet):
    policies = [untrained_policy(jax.random.key(number)) for number in range(2)]
    flown = transfer(
        policies, [find_reality("pybullet:3")], trials=2, key=jax.random.key(0), duration=0.3
    )
    assert flown.table["reality"].to_list() == ["pybullet:3"] * 4
    assert flown.table["position_error"].is_finite().all()


def test_a_reality_in_pybullet_needs_a_seed():
    with pytest.raises(
        InputError,
        match="pybullet:x: expected pybullet:SEED with a whole number, such as pybullet:7",
    ):
        find_reality("pybullet:x")


@pytest.mark.slow
def test_nothing_imports_pybullet_before_a_drone_flies_in_it():
    program = (
        "import sys, maidenflight.experiments.drones, maidenflight.cli; "
        "print('pybullet' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["False"]
