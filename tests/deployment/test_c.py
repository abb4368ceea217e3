"""The exported C computes what Python computes, remembers what the simulator remembers and refuses
to fly when damaged."""

import ctypes
import dataclasses
import hashlib
import re
import shutil
import subprocess
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maidenflight.deployment.c import (
    GOLDEN_COUNT,
    checksum,
    export_c,
    golden_observations,
)
from maidenflight.errors import InputError
from maidenflight.parameters import crazyflie
from maidenflight.policy import Actor, untrained_policy
from maidenflight.policy_file import to_json
from maidenflight.simulator import environment
from maidenflight.simulator.controllers.interface import INTERFACES
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.stepping import rollout
from maidenflight.simulator.tasks.look_ahead import LookAhead

STRICT = (
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Werror",
    "-std=c99",
    "-Wconversion",
    "-Wdouble-promotion",
)
COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]
NETWORKS = [((50, 50), 2), ((13, 7), 1), ((13, 7), 3), ((64,), 2), ((), 1)]
NUMBERS = np.ctypeslib.ndpointer(np.float32, flags="C_CONTIGUOUS")

pytestmark = pytest.mark.skipif(
    not COMPILERS, reason="no C compiler (gcc or clang) on this machine"
)


NOW = [
    ("position", ctypes.c_float * 3),
    ("quaternion", ctypes.c_float * 4),
    ("velocity", ctypes.c_float * 3),
    ("body_rates", ctypes.c_float * 3),
    ("setpoint", ctypes.c_float * 3),
]


class SimulatedFlight:
    """A compiled policy and its state."""

    def __init__(self, directory, history, level="-O3", compiler=None, ahead=0, memory=0):
        """Compiles `policy.c` of a directory, warnings being errors."""
        target = directory / f"policy{level}.so"
        command = [
            compiler or COMPILERS[0],
            *STRICT,
            level,
            "-shared",
            "-fPIC",
            "policy.c",
            "-o",
            target,
        ]
        found = subprocess.run(command, cwd=directory, capture_output=True, text=True)
        assert (found.returncode, found.stderr) == (0, "")

        class Now(ctypes.Structure):
            """mf_observation."""

            _fields_ = [*NOW, *([("ahead", ctypes.c_float * (3 * ahead))] if ahead else [])]

        class State(ctypes.Structure):
            _fields_ = [
                ("history", ctypes.c_float * 20 * history),
                *([("ahead", ctypes.c_float * (3 * ahead))] if ahead else []),
                *([("memory", ctypes.c_float * memory)] if memory else []),
                ("action", ctypes.c_float * 4),
                ("begun", ctypes.c_bool),
            ]

        self.library, self.state, self.now = ctypes.CDLL(str(target)), State(), Now
        self.outputs = 4 + memory
        self.library.mf_network.argtypes = [NUMBERS, NUMBERS]
        self.library.mf_policy_reset.argtypes = [ctypes.POINTER(State), NUMBERS]
        self.library.mf_policy_step.argtypes = [ctypes.POINTER(State), ctypes.POINTER(Now), NUMBERS]
        self.library.mf_policy_step.restype = self.library.mf_policy_self_test.restype = (
            ctypes.c_bool
        )
        self.self_test = self.library.mf_policy_self_test

    def network(self, observations):
        actions = np.empty((len(observations), self.outputs), np.float32)
        for observation, action in zip(observations, actions, strict=True):
            self.library.mf_network(observation, action)
        return actions

    def reset(self, action):
        self.library.mf_policy_reset(self.state, np.asarray(action, np.float32))

    def step(self, measurement, setpoint, *ahead):
        """Whether all was finite, and the commands."""
        parts = (
            measurement.position,
            measurement.quaternion,
            measurement.velocity,
            measurement.body_rates,
            setpoint,
            *ahead,
        )
        kinds: list[Any] = [field[1] for field in self.now._fields_]
        values = [kind(*np.ravel(part).tolist()) for kind, part in zip(kinds, parts, strict=True)]
        now = self.now(*values)
        command = np.full(4, np.nan, np.float32)
        return self.library.mf_policy_step(self.state, now, command), command

    history = property(lambda self: np.array(self.state.history))
    action = property(lambda self: np.array(self.state.action))


def restless(spec=PolicySpec(), interface=None):
    """A policy with biases, whose actions are of order 1, sometimes beyond; weak in the last
    action, lest a flight run away."""
    policy = untrained_policy(jax.random.key(3), interface, spec)
    keys = jax.random.split(jax.random.key(4), len(policy.biases))
    biases = tuple(
        jax.random.normal(key, bias.shape) * 0.3
        for key, bias in zip(keys, policy.biases, strict=True)
    )
    weaker = jnp.tile(jnp.where(jnp.arange(20) < 16, 1.0, 10.0), spec.history)
    deviation = policy.observation_std * jnp.concatenate([weaker, jnp.ones(spec.look_ahead.size)])
    weights = (*policy.weights[:-1], 5.0 * policy.weights[-1])
    return dataclasses.replace(policy, weights=weights, biases=biases, observation_std=deviation)


def walk(steps, seed=0):
    """Measurements and set-points that wander as in a flight."""
    random = np.random.default_rng(seed)
    drift = np.cumsum(random.normal(size=(steps, 16)) * 0.02, axis=0).astype(np.float32)
    quaternion = drift[:, 3:7] + np.array([0, 0, 0, 1], np.float32)
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    moments = zip(
        drift[:, :3] + np.array([0, 0, 1], np.float32),
        drift[:, 7:10],
        quaternion,
        5 * drift[:, 10:13],
        strict=True,
    )
    return [Measurement(*moment) for moment in moments], drift[:, 13:] + np.array(
        [0, 0, 1], np.float32
    )


@pytest.fixture
def flown(tmp_path):
    """Exports and compiles."""
    return lambda policy, level="-O3", compiler=None: SimulatedFlight(
        export_c(policy, tmp_path)[0].parent,
        policy.spec.history,
        level,
        compiler,
        policy.spec.look_ahead.points,
        policy.spec.memory,
    )


@pytest.mark.parametrize(("hidden", "history"), NETWORKS)
@pytest.mark.parametrize(
    ("compiler", "level"), [(name, level) for name in COMPILERS for level in ("-O3", "-Os")]
)
def test_network_computes_what_python_computes_and_passes_its_self_test(
    flown, hidden, history, compiler, level
):
    policy = restless(PolicySpec(history=history, hidden=hidden))
    spread = np.random.default_rng(1).normal(size=(10_000, 20 * history)).astype(np.float32)
    observations = np.asarray(policy.observation_mean) + np.asarray(policy.observation_std) * spread
    expected = np.asarray(jax.vmap(policy)(jnp.asarray(observations)))
    drone = flown(policy, level, compiler)
    error = np.abs(drone.network(observations) - expected)
    assert np.all(error <= 1e-5 * np.maximum(1.0, np.abs(expected)))
    assert np.abs(expected).max() > 1.0
    assert drone.self_test()


@pytest.mark.parametrize("compiler", COMPILERS)
def test_a_policy_that_looks_ahead_sees_the_points_that_the_caller_gives(flown, compiler):
    """Step by step as in Python; a point that is not finite gives no command and is forgotten."""
    policy = restless(PolicySpec(look_ahead=LookAhead(3, 0.1), hidden=(13,)))
    drone, actor = flown(policy, compiler=compiler), Actor(policy, 0.5)
    assert drone.self_test()
    observations = golden_observations(policy, 1)
    assert observations.shape == (GOLDEN_COUNT, 49)
    expected = np.asarray(jax.vmap(policy)(jnp.asarray(observations)))
    np.testing.assert_allclose(drone.network(observations), expected, rtol=1e-5, atol=1e-5)
    level = np.asarray(policy.interface.level(jnp.float32(0.5)))
    measurements, setpoints = walk(20)
    points = np.random.default_rng(5).normal(size=(20, 3, 3)).astype(np.float32)
    poisoned = points[0].copy()
    poisoned[2, 1] = np.nan
    for _ in range(2):
        drone.reset(level)
        actor.reset()
        for measurement, setpoint, ahead in zip(measurements, setpoints, points, strict=True):
            finite, command = drone.step(measurement, setpoint, ahead)
            wanted, action = actor.act(measurement, setpoint, ahead)
            assert finite
            np.testing.assert_allclose(drone.action, action, rtol=1e-5, atol=1e-5)
            np.testing.assert_allclose(command, wanted, rtol=0, atol=1e-5)
            seen = np.asarray(drone.state.ahead).reshape(3, 3)
            np.testing.assert_allclose(seen, ahead - np.asarray(measurement.position), atol=1e-6)
        kept = drone.action
        finite, command = drone.step(measurements[0], setpoints[0], poisoned)
        assert not finite
        assert command.tolist() == [0.0] * 4
        np.testing.assert_array_equal(drone.action, kept)
        assert not drone.state.begun


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "memory", "points", "compiler"),
    [((50, 50), 16, 0, COMPILERS[0]), ((13,), 5, 2, COMPILERS[-1])] if COMPILERS else [],
)
def test_5000_steps_of_a_policy_that_remembers_are_pythons(flown, hidden, memory, points, compiler):
    """With the memory carried over; after a number that is not finite it begins empty."""
    policy = restless(PolicySpec(2, LookAhead(points, 0.1), memory, hidden))
    drone, actor = flown(policy, compiler=compiler), Actor(policy, 0.5)
    assert drone.self_test()
    observations = golden_observations(policy, 1)
    assert observations.shape == (GOLDEN_COUNT, 40 + 3 * points + memory)
    expected = np.asarray(jax.vmap(policy)(jnp.asarray(observations)))
    np.testing.assert_allclose(drone.network(observations), expected, rtol=1e-5, atol=1e-5)
    drone.reset(np.asarray(policy.interface.level(jnp.float32(0.5))))
    ahead = [np.ones((points, 3), np.float32)] if points else []
    errors = []
    for measurement, setpoint in zip(*walk(5000), strict=True):
        finite, command = drone.step(measurement, setpoint, *ahead)
        wanted, action = actor.act(measurement, setpoint, *ahead)
        assert finite
        errors.append(np.abs(np.concatenate([drone.action - action, command - wanted])).max())
    assert np.max(errors) < 1e-4
    assert np.mean(np.array(errors) < 1e-5) > 0.95
    assert np.abs(drone.state.memory).max() > 0.1
    (first, *_), setpoints = walk(1)
    unknown = first._replace(position=np.full(3, np.nan, np.float32))
    assert not drone.step(unknown, setpoints[0], *ahead)[0]
    drone.reset(np.asarray(policy.interface.level(jnp.float32(0.5))))
    actor.reset()
    _, command = drone.step(first, setpoints[0], *ahead)
    wanted, _ = actor.act(first, setpoints[0], *ahead)
    np.testing.assert_allclose(command, wanted, rtol=0, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize(
    ("structure", "history"),
    [("pwm", 1), ("pwm", 2), ("pwm", 3), *((name, 2) for name in INTERFACES if name != "pwm")],
)
def test_500_steps_remember_what_python_remembers(flown, structure, history, compiler):
    policy = restless(PolicySpec(history=history), INTERFACES[structure]())
    commanded = policy.interface
    drone, act, observe = (
        flown(policy, compiler=compiler),
        jax.jit(lambda seen: policy(seen)),
        jax.jit(environment.observe),
    )
    action = np.full(4, 0.1, np.float32)
    drone.reset(action)
    memory, actions = None, []
    for measurement, setpoint in zip(*walk(500), strict=True):
        instant = observe(measurement, setpoint, action)
        memory = (
            np.tile(instant, (history, 1)) if memory is None else np.vstack([memory[1:], instant])
        )
        action = act(memory.reshape(-1))
        finite, command = drone.step(measurement, setpoint)
        assert finite
        np.testing.assert_allclose(drone.history, memory, rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(drone.action, action, rtol=1e-5, atol=1e-5)
        wanted = np.array(commanded.centre) + np.array(commanded.span) * np.clip(action, -1, 1)
        np.testing.assert_allclose(command, wanted, rtol=0, atol=1e-5)
        actions.append(action)
    assert np.min(actions) < -1.0
    assert np.max(actions) > 1.0


@pytest.mark.slow
def test_an_episode_of_the_simulator_is_seen_as_the_simulator_sees_it(flown):
    policy, world, parameters = (
        untrained_policy(jax.random.key(5)),
        environment.Environment(),
        crazyflie(),
    )
    begin_key, key = jax.random.split(jax.random.key(6))
    env_state = environment.reset(world, parameters, begin_key)
    _, (episodes, _) = rollout(world, policy, env_state, parameters, key, 30)
    drone = flown(policy)
    drone.reset(env_state.action)
    for number in range(30):
        measurement = Measurement(*(part[number] for part in episodes.measurement))
        drone.step(measurement, world.task.reference(episodes.time[number]))
        np.testing.assert_allclose(drone.history, episodes.history[number], rtol=0, atol=2e-6)


def test_reset_begins_with_copies_of_the_first_instant_and_forgets_what_was(flown):
    drone, (measurements, setpoints) = flown(restless(PolicySpec(history=3))), walk(5)
    drone.reset([0.5, -2.0, 3.0, 0.25])
    _, first = drone.step(measurements[0], setpoints[0])
    fresh = drone.history
    assert np.all(fresh == fresh[0])
    assert fresh[0, 16:].tolist() == [0.5, -2.0, 3.0, 0.25]
    for measurement, setpoint in zip(measurements, setpoints, strict=True):
        drone.step(measurement, setpoint)
    assert not np.all(drone.history == drone.history[0])
    drone.reset([0.5, -2.0, 3.0, 0.25])
    assert np.array_equal(drone.step(measurements[0], setpoints[0])[1], first)
    assert np.array_equal(drone.history, fresh)


def test_commands_are_clipped_and_the_remembered_action_is_not(flown):
    policy = untrained_policy(jax.random.key(0))
    policy = dataclasses.replace(
        policy,
        weights=tuple(0 * weight for weight in policy.weights),
        biases=(*policy.biases[:-1], jnp.array([-5.0, -1.0, 0.5, 7.0])),
    )
    drone, (measurements, setpoints) = flown(policy), walk(2)
    drone.reset(np.zeros(4))
    assert drone.step(measurements[0], setpoints[0])[1].tolist() == [0.0, 0.0, 0.75, 1.0]
    drone.step(measurements[1], setpoints[1])
    assert drone.history[1, 16:].tolist() == drone.action.tolist() == [-5.0, -1.0, 0.5, 7.0]


@pytest.mark.parametrize(("structure", "action", "thrust", "turns"), [
    ("attitude_rate", [-0.5, -3.0, 0.5, 1.0], 0.25, [-60.0, 30.0, 60.0]),
    ("attitude", [-3.0, -1.0, 0.5, 0.1], 35 / 60, [-10.0, 5.0, 1.0]),
])  # fmt: skip
def test_set_points_are_those_that_the_simulated_pids_are_given(
    flown, structure, action, thrust, turns
):
    policy = untrained_policy(jax.random.key(0), INTERFACES[structure](), PolicySpec(hidden=()))
    still = tuple(0 * weight for weight in policy.weights)
    drone, (measurements, setpoints) = (
        flown(dataclasses.replace(policy, weights=still, biases=(jnp.array(action),))),
        walk(1),
    )
    drone.reset(np.zeros(4))
    finite, command = drone.step(measurements[0], setpoints[0])
    assert finite
    np.testing.assert_allclose(command, [thrust, *np.radians(turns)], rtol=1e-6)
    assert drone.self_test()


@pytest.mark.parametrize("structure", ["attitude_rate", "attitude"])
def test_the_action_that_keeps_level_asks_for_hover_and_nothing_else(flown, structure):
    policy = untrained_policy(jax.random.key(0), INTERFACES[structure](), PolicySpec(hidden=()))
    level = policy.interface.level(jnp.float32(0.6))
    still = tuple(0 * weight for weight in policy.weights)
    drone, (measurements, setpoints) = (
        flown(dataclasses.replace(policy, weights=still, biases=(level,))),
        walk(1),
    )
    drone.reset(np.zeros(4))
    np.testing.assert_allclose(
        drone.step(measurements[0], setpoints[0])[1], [0.6, 0, 0, 0], atol=1e-6
    )


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("velocity", (0, np.nan, 0)),
        ("velocity", (0, np.inf, 0)),
        ("body_rates", (0, 0, -np.inf)),
        ("quaternion", (0, 0, 0, 0)),
        ("quaternion", (0, 0, 0, 1.2)),
        ("position", (1e6, 0, 1)),
    ],
)
def test_senseless_numbers_stop_the_motors_and_are_not_remembered(flown, field, value):
    drone, (measurements, setpoints) = flown(restless()), walk(4)
    drone.reset(np.zeros(4))
    drone.step(measurements[0], setpoints[0])
    action = drone.action
    senseless = measurements[1]._replace(**{field: np.array(value, np.float32)})
    finite, command = drone.step(senseless, setpoints[1])
    assert not finite
    assert command.tolist() == [0, 0, 0, 0]
    assert np.array_equal(drone.action, action)
    finite, _ = drone.step(measurements[2], setpoints[2])
    assert finite
    assert np.array_equal(drone.history[0], drone.history[1])


@pytest.mark.parametrize(
    "table",
    [
        "mean",
        "deviation",
        "centre",
        "span",
        "weights_1",
        "biases_2",
        "weights_3",
        "golden_observations",
        "golden_actions",
    ],
)
def test_self_test_fails_when_one_number_is_damaged(tmp_path, table):
    _, source = export_c(restless(PolicySpec(hidden=(13, 7))), tmp_path)
    text = source.read_text()
    place = text.index("{\n", text.index(f" {table}["))
    damaged = text[:place] + re.sub(r"-?[\d.]+(e-?\d+)?f", "0.8125f", text[place:], count=1)
    assert damaged != text
    source.write_text(damaged)
    assert not SimulatedFlight(tmp_path, 2).self_test()


def test_checksum_sees_a_change_of_the_last_bit():
    numbers = np.linspace(-1, 1, 100, dtype=np.float32)
    for place in range(100):
        changed = numbers.copy()
        changed[place] = np.nextafter(changed[place], np.float32(2))
        assert checksum([numbers]) != checksum([changed])
    assert checksum([]) == 0x811C9DC5


def test_golden_observations_have_unit_quaternions_and_change_with_the_seed():
    policy = untrained_policy(jax.random.key(0), spec=PolicySpec(history=3))
    golden = golden_observations(policy, 0)
    assert golden.shape == (GOLDEN_COUNT, 60)
    np.testing.assert_allclose(np.linalg.norm(golden.reshape(-1, 20)[:, 3:7], axis=1), 1, rtol=1e-6)
    assert not np.array_equal(golden, golden_observations(policy, 1))


def test_same_policy_and_seed_give_the_same_bytes(tmp_path):
    once, again, other = (
        [file.read_bytes() for file in export_c(restless(), tmp_path / name, seed=seed)]
        for name, seed in (("once", 7), ("again", 7), ("other", 8))
    )
    assert once == again
    assert once[1] != other[1]
    assert hashlib.sha256(to_json(restless()).encode()).hexdigest().encode() in once[0]


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("level", ["-O0", "-O2", "-O3", "-Os"])
def test_every_compiler_and_level_is_silent_and_agrees(tmp_path, compiler, level):
    export_c(
        restless(PolicySpec(history=1, hidden=(6,))),
        tmp_path,
        record={"note": "ends */ /* here ??/ or not", "path": "a" * 300},
    )
    assert SimulatedFlight(tmp_path, 1, level, compiler).self_test()


@pytest.mark.parametrize(
    ("structure", "act", "hover"),
    [("pwm", "drive_motors", None), ("attitude_rate", "follow", 0.58), ("attitude", "follow", 0.5)],
)
def test_the_header_s_example_compiles(tmp_path, structure, act, hover):
    header, _ = export_c(
        untrained_policy(jax.random.key(0), INTERFACES[structure](), PolicySpec(hidden=(8,))),
        tmp_path,
        hover=hover,
    )
    share = re.search(r"^#define MF_HOVER (\S+)f ", header.read_text(), re.MULTILINE)
    assert (None if share is None else float(share[1])) == hover
    found = re.search(r"Example:\n(.*?)\n \*/", header.read_text(), re.DOTALL)
    assert found is not None
    example = found[1]
    body = "\n".join(line.removeprefix(" *") for line in example.splitlines())
    names = "thrust_to_weight, x, y, z, qx, qy, qz, qw, vx, vy, vz, p, q, r, goal_x, goal_y, goal_z"
    (tmp_path / "example.c").write_text(
        f'#include "policy.h"\nextern float {names};\nbool next_period(float);\nvoid {act}(const '
        "float *);\nbool fly(void);\n"
        f"bool fly(void)\n{{\n{body}\n    return true;\n}}\n"
    )
    subprocess.run([COMPILERS[0], *STRICT, "-c", "example.c"], cwd=tmp_path, check=True)


def test_what_cannot_be_exported_is_refused(tmp_path):
    policy = restless()
    for wrong, message in (
        (
            dataclasses.replace(
                policy, biases=(*policy.biases[:-1], jnp.array([0, 0, jnp.nan, 0]))
            ),
            "not a finite number",
        ),
        (
            dataclasses.replace(policy, weights=(*policy.weights[:-1], jnp.full((4, 50), 3e38))),
            "overflows float32",
        ),
        (jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), policy), "expected"),
    ):
        with pytest.raises(InputError, match=message):
            export_c(wrong, tmp_path)
    assert not list(tmp_path.iterdir())
