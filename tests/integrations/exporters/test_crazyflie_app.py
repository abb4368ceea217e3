"""The exported app does in the firmware what Python's policy does, hands back when it must, and is
silent under every compiler.

The firmware is not here. Stand-ins for its headers and for its build lie in `crazyflie/firmware`;
`harness.c` calls the app a thousand times a second of its own time, and its PID tells what it was
asked.
"""

import ctypes
import dataclasses
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from app_in_firmware import (
    ABSOLUTE,
    COMPILERS,
    FORCE,
    FORCE_TORQUE,
    HERE,
    HOVER_THRUST,
    LEGACY,
    START,
    STRICT,
    VELOCITY,
    App,
    built,
    hovering,
    make,
)
from jax import lax
from test_c import restless

from maidenflight.deployment.c import digest
from maidenflight.errors import InputError
from maidenflight.integrations.exporters import crazyflie_app as crazyflie_app
from maidenflight.integrations.exporters.crazyflie_app import MOST_MULTIPLICATIONS, export_crazyflie
from maidenflight.integrations.radio.blocks import ACTIVE, ENABLE, REASONS
from maidenflight.names import PROPELLERS
from maidenflight.parameters import crazyflie, replace
from maidenflight.policy import Policy, untrained_policy
from maidenflight.simulator import environment
from maidenflight.simulator.controllers import control, firmware, interface
from maidenflight.simulator.controllers.control import CONTROLLERS
from maidenflight.simulator.controllers.position_pid import position_pid
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics import dynamics, rotations
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.stepping import rollout
from maidenflight.simulator.tasks import tasks
from maidenflight.simulator.tasks.look_ahead import LookAhead

PAGE = Path(__file__).parents[3] / "docs/real-drones.md"
PROCESSOR = (
    "-mcpu=cortex-m4",
    "-mthumb",
    "-mfpu=fpv4-sp-d16",
    "-mfloat-abi=hard",
    "-ffreestanding",
    f"-I{HERE / 'bare'}",
)
(
    DISABLED,
    TILT,
    BODY_RATE,
    DISTANCE,
    NOT_FINITE,
    NO_POSITION,
    PARAMETERS,
    SELF_TEST,
    SWITCHED_AWAY,
    _,
    BATTERY,
    FENCE,
    CEILING,
    TIME,
    ESTIMATE,
    OTHER_DRONE,
) = range(1, 17)
pytestmark = pytest.mark.skipif(
    not COMPILERS or not shutil.which("make"),
    reason="no C compiler (gcc or clang) or no make on this machine",
)


AHEAD, STRONG = "pwm_looking_ahead", "pwm_beyond_full_scale"


def policy_of(structure: str) -> Policy:
    if structure == STRONG:
        return restless(PolicySpec(hidden=(8,)), interface.pwm(most=1.2))
    if structure == AHEAD:
        return restless(PolicySpec(look_ahead=LookAhead(3, 0.2), hidden=(8,)))
    return restless(PolicySpec(hidden=(8,)), CONTROLLERS[structure]().interface)


Load = Callable[..., App]


@pytest.fixture(scope="module")
def load(tmp_path_factory: pytest.TempPathFactory) -> Load:
    """Builds each structure's app once, by the Makefile beside the stand-in firmware, and switches
    on a copy of it each time."""
    libraries: dict[str, Path] = {}

    def new(structure: str = "pwm", damage: Callable[[bytes], bytes] = lambda image: image) -> App:
        if structure not in libraries:
            folder = tmp_path_factory.mktemp(structure)
            libraries[structure] = built(policy_of(structure), folder)
        copy = tmp_path_factory.mktemp("flown") / "app.so"
        copy.write_bytes(damage(libraries[structure].read_bytes()))
        app = App(copy)
        app.set(x=START[0], y=START[1])
        return app

    return new


@pytest.mark.parametrize("structure", CONTROLLERS)
def test_the_app_compiles_without_a_word(structure: str, tmp_path: Path) -> None:
    export_crazyflie(policy_of(structure), tmp_path, record={"note": "*/"})
    for compiler in COMPILERS:
        shutil.rmtree(tmp_path / "build", ignore_errors=True)
        made = make(tmp_path, compiler, "-fPIC")
        assert (made.returncode, made.stdout, made.stderr) == (0, "", "")


@pytest.mark.skipif(
    not shutil.which("arm-none-eabi-gcc"), reason="no arm-none-eabi-gcc on this machine"
)
@pytest.mark.parametrize("structure", CONTROLLERS)
def test_the_app_compiles_for_the_drone_s_processor_and_is_small(
    structure: str, tmp_path: Path
) -> None:
    policy = untrained_policy(jax.random.key(0), interface=CONTROLLERS[structure]().interface)
    network = ("mf_network", "apply")
    stacks = stacks_of(policy, tmp_path)
    stack = deepest(stacks, "controllerOutOfTree", "mf_policy_step", *network)
    sized = ["arm-none-eabi-size", "-t", "maidenflight.o", "policy.o"]
    listed = subprocess.run(sized, cwd=tmp_path / "src", capture_output=True, text=True)
    text, data, bss = (int(number) for number in listed.stdout.splitlines()[-1].split()[:3])
    print(f"text {text}, data {data}, bss {bss}, stack {stack} bytes")
    assert stack < 400
    assert text + data < 27_000
    assert data + bss < 1000


@pytest.mark.skipif(
    not shutil.which("arm-none-eabi-gcc"), reason="no arm-none-eabi-gcc on this machine"
)
def test_the_self_test_fits_on_the_stack_of_start_up_however_wide_the_network(
    tmp_path: Path,
) -> None:
    wide = untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(270,)))
    assert sum(weight.size for weight in wide.weights) > 0.9 * MOST_MULTIPLICATIONS
    stacks = stacks_of(wide, tmp_path)
    called = ("controllerOutOfTreeInit", "mf_policy_self_test", "mf_network", "apply")
    assert deepest(stacks, *called) < 200
    assert deepest(stacks, "controllerOutOfTree", "mf_policy_step", "mf_network", "apply") < 400


def stacks_of(policy: Policy, folder: Path) -> dict[str, int]:
    """Bytes of stack of the app's functions, as compiled for the drone's processor."""
    export_crazyflie(policy, folder)
    for source in ("maidenflight", "policy"):
        command = [
            "arm-none-eabi-gcc",
            *PROCESSOR,
            *STRICT,
            "-fstack-usage",
            f"-I{HERE / 'firmware'}",
            "-c",
            f"{source}.c",
        ]
        found = subprocess.run(command, cwd=folder / "src", capture_output=True, text=True)
        assert (found.returncode, found.stderr) == (0, "")
    return {
        name: int(size)
        for file in (folder / "src").glob("*.su")
        for name, size in re.findall(r":(\w+)\t(\d+)\tstatic", file.read_text())
    }


def deepest(stacks: dict[str, int], *calls: str) -> int:
    """Bytes of stack of functions that call each other; those built into their callers have none
    of their own."""
    return sum(stacks.get(name, 0) for name in calls)


def test_without_a_firmware_make_says_what_it_needs(tmp_path: Path) -> None:
    export_crazyflie(policy_of("pwm"), tmp_path)
    made = make(tmp_path, COMPILERS[0], base=tmp_path)
    assert made.returncode
    assert "make CRAZYFLIE_BASE=/path/to/crazyflie-firmware" in made.stderr


def test_forces_are_not_built_with_a_firmware_that_leaves_them_out(tmp_path: Path) -> None:
    folders = {structure: tmp_path / structure for structure in CONTROLLERS}
    for structure, folder in folders.items():
        export_crazyflie(policy_of(structure), folder)
        told = "2025.12" if structure == "pwm" else "2023.11"
        assert f"{told} or later" in (folder / "README.md").read_text()
    older = tmp_path / "older"
    shutil.copytree(HERE / "firmware", older)
    mixer = older / "src/modules/src/power_distribution_quadrotor.c"
    mixer.write_text(mixer.read_text().replace("normalizedForces", "nothing"))
    made = {
        structure: make(folder, COMPILERS[0], "-fPIC", base=older)
        for structure, folder in folders.items()
    }
    assert "2025.12" in made["pwm"].stderr
    assert len(made["pwm"].stderr.splitlines()) == 1
    assert not (folders["pwm"] / "build").exists()
    assert [made[structure].returncode for structure in CONTROLLERS] == [2, 0, 0]


def test_the_configuration_names_the_propellers(tmp_path: Path) -> None:
    assert tuple(crazyflie_app.PROPELLERS) == PROPELLERS
    configured = {}
    for number, propellers in enumerate(PROPELLERS):
        export_crazyflie(policy_of("pwm"), tmp_path / str(number), propellers=propellers)
        text = (tmp_path / str(number) / "app-config").read_text()
        configured[propellers] = {line for line in text.splitlines() if "CRAZYFLIE" in line}
        assert make(tmp_path / str(number), COMPILERS[0], "-fPIC").returncode == 0
    assert configured == {
        "2.1+": set(),
        "legacy": {"CONFIG_CRAZYFLIE_LEGACY_PROPELLERS=y"},
        "thrust-upgrade": {"CONFIG_CRAZYFLIE_THRUST_UPGRADE_KIT=y"},
    }
    with pytest.raises(InputError, match="propellers = 'wooden'"):
        export_crazyflie(policy_of("pwm"), tmp_path / "wooden", propellers="wooden")
    assert not (tmp_path / "wooden").exists()


def test_the_pid_flies_until_the_policy_is_enabled(load: Load) -> None:
    app = load()
    assert app.test()
    found = app.hover(25)
    assert (found["calls"] == 1).all()
    assert found["asked"]["step"][:, 0].tolist() == list(range(1, 26))
    assert (found["asked"]["modes"][:, 0] == hovering(1)["modes"][0]).all()
    assert (found["mode"] == LEGACY).all()
    assert found["thrust"][-1] == HOVER_THRUST
    assert found["torque"][-1].tolist() == [11, 22, 33]
    assert (app.log("active"), app.log("state"), app.log("why")) == (0, 0, 0)


@pytest.fixture(scope="module")
def flight() -> tuple[Measurement, np.ndarray]:
    """Estimates of 2 s of the simulated PID on the circle, 100 a second, and the set-points."""
    structure = position_pid("2026.08")
    # With the slow motors of the paper that PID does not hold the drone.
    quick = replace(crazyflie(), motor_time_constant=np.float32(0.03), latency=np.float32(0.0))
    drone = control.in_fitting_steps(quick, structure)
    env = Environment.matching(drone, tasks.circle(), structure)
    state = dynamics.at_hover(jnp.array([0.0, 0.0, 1.0]), drone)._replace(
        quaternion=rotations.from_attitude(jnp.array([0.1, -0.1, 0.3]))
    )
    env_state = environment.begin(env, state, jnp.zeros(()), drone, jax.random.key(0))
    fly = jax.jit(
        lambda env_state, key: rollout(env, lambda seen: jnp.zeros(4), env_state, drone, key, 200)[
            1
        ][0]
    )
    episodes = fly(env_state, jax.random.key(1))
    times = jnp.asarray(np.arange(200) / 100, jnp.float32)
    return Measurement(*(jnp.asarray(part) for part in episodes.measurement)), np.asarray(
        jax.vmap(tasks.circle().reference)(times)
    )


def milliseconds(flight: Measurement, every: int) -> np.ndarray:
    """Estimates in the firmware's units and axes, 10 ms each, from a start elsewhere; only where
    the policy must look are they right."""
    position, velocity, quaternion, body_rates = (
        np.repeat(np.asarray(part), 10, axis=0) for part in flight
    )
    given, rows = hovering(len(position)), np.arange(len(position))[:, None]
    wrong = np.random.default_rng(0).normal(size=position.shape) * 0.01
    given["position"] = position + np.array([*START, 0.0]) + np.where(rows % every, wrong, 0.0)
    given["velocity"] = velocity
    # An attitude has two quaternions, and an estimator may change from one to the other.
    given["quaternion"] = quaternion * np.where(rows // 300 % 2, 1, -1)
    given["gyro"] = np.degrees(body_rates)
    return given


def actions_in_python(
    policy: Policy,
    flight: Measurement,
    setpoints: np.ndarray,
    share: float,
    ahead: np.ndarray | None = None,
) -> np.ndarray:
    """One for each 10 ms, from what the policy would see, its last action before the first being
    the one that keeps level."""
    every = 100 // policy.interface.rate
    action, memory, actions = (
        np.asarray(policy.interface.level(jnp.float32(share))),
        None,
        [],
    )
    act, observe = jax.jit(policy.__call__), jax.jit(environment.observe)
    for row in range(0, len(setpoints), every):
        instant = np.asarray(
            observe(Measurement(*(part[row] for part in flight)), setpoints[row], action)
        )
        memory = (
            np.tile(instant, (policy.spec.history, 1))
            if memory is None
            else np.vstack([memory[1:], instant])
        )
        later = () if ahead is None else np.ravel(ahead[row] - np.asarray(flight.position)[row])
        action = np.asarray(act(np.concatenate([memory.reshape(-1), later], dtype=np.float32)))
        actions += [action] * every
    return np.array(actions)


def asked_in_flight(app: App, given: np.ndarray) -> np.ndarray:
    """From the step at which the policy takes over."""
    app.enable()
    found = app.fly(given)
    assert (app.log("active"), app.log("state"), app.log("why"), app.log("us")) == (1, 1, 0, 123)
    return found


@pytest.mark.parametrize("structure", ["pwm", STRONG])
@pytest.mark.slow
def test_motors_are_commanded_as_by_python_s_policy(
    load: Load, flight: tuple[Measurement, np.ndarray], structure: str
) -> None:
    policy, (measured, setpoints) = policy_of(structure), flight
    found = asked_in_flight(load(structure), milliseconds(measured, 10))
    actions = actions_in_python(policy, measured, setpoints, HOVER_THRUST / 60000)
    commands = np.repeat(jax.vmap(policy.interface.command)(jnp.asarray(actions)), 10, axis=0)
    forces = commands * (60000 / 65535)
    np.testing.assert_allclose(found["forces"], forces, rtol=0, atol=1e-5)
    # The firmware cuts off single forces above 1, and takes their sum and torques as they are.
    modes = np.where(forces.max(axis=1) > 1.0, FORCE_TORQUE, FORCE)
    assert np.array_equal(found["mode"], modes)
    assert set(modes) == ({FORCE} if structure == "pwm" else {FORCE, FORCE_TORQUE})
    # The PID forgets when the policy takes over, and then has nothing to do.
    assert found["calls"].tolist() == [1] + [0] * (len(found) - 1)
    assert np.std(actions, axis=0).min() > 0.05


def test_a_policy_that_looks_ahead_sees_the_circle_to_come(
    load: Load, flight: tuple[Measurement, np.ndarray]
) -> None:
    policy, (measured, setpoints) = policy_of(AHEAD), flight
    found = asked_in_flight(load(AHEAD), milliseconds(measured, 10))
    times = jnp.asarray(np.arange(200)[:, None] / 100 + [0.2, 0.4, 0.6], jnp.float32)
    later = jax.vmap(jax.vmap(tasks.circle().reference))(times)
    shares = HOVER_THRUST / 60000, np.asarray(later)
    actions = actions_in_python(policy, measured, setpoints, *shares)
    commands = np.repeat((np.clip(actions, -1, 1) + 1) / 2, 10, axis=0)
    np.testing.assert_allclose(found["forces"] * (65535 / 60000), commands, rtol=0, atol=1e-5)


def test_a_policy_that_looks_ahead_hovers_and_takes_set_points_with_their_motion(
    load: Load,
) -> None:
    app = load(AHEAD)
    assert app.parameters["ahead"].value == 3
    assert app.read_only == {"ahead", "hash", "propellers"}
    app.enable(task=0)
    (found,) = app.hover()
    at_start = Measurement(
        *(
            jnp.array([numbers])
            for numbers in ([0.0, 0, 1], [0.0, 0, 0], [0.0, 0, 0, 1], [0.0, 0, 0])
        )
    )
    here = np.array([[0, 0, 1]], np.float32)
    stays = HOVER_THRUST / 60000, np.broadcast_to(here, (1, 3, 3))
    (action,) = actions_in_python(policy_of(AHEAD), at_start, here, *stays)
    still = (np.clip(action, -1, 1) + 1) / 2
    np.testing.assert_allclose(found["forces"] * (65535 / 60000), still, rtol=0, atol=1e-5)
    led = load(AHEAD)
    led.set(task=2)
    led.until(1000)
    led.set(enable=1)
    velocity, acceleration = np.array([0.5, -0.3, 0.2]), np.array([0.4, 1.0, -0.6])
    (found,) = led.hover(wanted_velocity=velocity, wanted_acceleration=acceleration)
    later = np.array([[0.2], [0.4], [0.6]])
    motion = here + velocity * later + acceleration * later**2 / 2
    (action,) = actions_in_python(policy_of(AHEAD), at_start, here, stays[0], motion[None])
    moving = (np.clip(action, -1, 1) + 1) / 2
    np.testing.assert_allclose(found["forces"] * (65535 / 60000), moving, rtol=0, atol=1e-5)
    assert np.abs(moving - still).max() > 1e-3


def test_the_action_before_the_first_is_that_of_the_pid_s_mean_thrust(load: Load) -> None:
    app = load("pwm")
    app.hover(499, thrust=30_000)
    app.hover(500, thrust=45_000)
    app.set(enable=1)
    (found,) = app.hover()
    # The position loop finds the new thrust at step 500, which is the 500th.
    mean = 45_000 - 15_000 * 0.998**500
    at_start = Measurement(
        *(
            jnp.array([numbers])
            for numbers in ([0.0, 0, 1], [0.0, 0, 0], [0.0, 0, 0, 1], [0.0, 0, 0])
        )
    )
    for thrust, same in ((mean, True), (45_000, False)):
        (action,) = actions_in_python(
            policy_of("pwm"), at_start, np.array([[0, 0, 1]], np.float32), thrust / 60_000
        )
        commands = (np.clip(action, -1, 1) + 1) / 2
        assert np.allclose(found["forces"] * (65535 / 60000), commands, rtol=0, atol=1e-5) == same


@pytest.mark.parametrize("structure", ["attitude_rate", "attitude"])
@pytest.mark.slow
def test_the_firmware_s_pids_are_asked_as_in_the_simulator(
    load: Load, flight: tuple[Measurement, np.ndarray], structure: str
) -> None:
    policy, (measured, setpoints) = policy_of(structure), flight
    app = load(structure)
    found = asked_in_flight(app, milliseconds(measured, 1000 // policy.interface.rate))
    actions = actions_in_python(policy, measured, setpoints, HOVER_THRUST / 60000)
    assert found["calls"].tolist() == [2] + [1] * (len(found) - 1)
    first, asked = found["asked"][0, 0], found["asked"][:, 0].copy()
    assert (first["thrust"], first["step"], first["modes"].tolist()) == (0, 0, [0] * 7)
    asked[0] = found["asked"][0, 1]
    assert asked["step"].tolist() == list(range(1000, 3000))
    upright = np.array([1, -1, 1], np.float32)  # the firmware's pitch is positive nose up
    thrust, *turns = np.repeat(np.clip(actions, -1, 1), 10, axis=0).T
    most, tolerance, middle, span, mode = {
        "attitude_rate": (60, 6e-4, 30000, 30000, VELOCITY),
        "attitude": (10, 1e-4, 45000, 10000, ABSOLUTE),
    }[structure]
    found_turns = asked[structure.removeprefix("attitude_")] * upright
    np.testing.assert_allclose(found_turns, most * np.transpose(turns), rtol=0, atol=tolerance)
    np.testing.assert_allclose(asked["thrust"], middle + span * thrust, rtol=0, atol=0.6)
    assert (asked["modes"] == [0, 0, 0, mode, mode, mode, 0]).all()
    np.testing.assert_allclose(
        [app.log(f"a{number}") for number in (1, 2, 3, 4)], actions[-1], rtol=0, atol=1e-5
    )

    # And what the firmware's cascade makes of that is what the simulated controller makes of the
    # actions.
    structured, step = CONTROLLERS[structure](), 2
    rows = np.repeat(np.arange(len(actions)), 10 // step)
    held = Measurement(*(jnp.asarray(part[rows]) for part in measured))

    def simulated(memory, now):
        action, measurement = now
        return structured.command(memory, action, measurement, jnp.zeros(3))

    def by_firmware(memory, now):
        measurement, attitude, rate, thrust, modes = now
        wanted = control.NOTHING._replace(
            attitude=attitude, body_rates=rate, thrust=thrust, mode=modes
        )
        return firmware.tick(
            memory, wanted, control.sensed(measurement), "2026.08", position_due=False
        )

    wanted = (
        held,
        asked["attitude"][::step] * upright,
        asked["rate"][::step] * upright,
        asked["thrust"][::step],
        asked["modes"][::step, :6],
    )
    _, expected = lax.scan(simulated, structured.init(), (jnp.asarray(actions[rows]), held))
    _, motors = lax.scan(by_firmware, firmware.switched_on(), jax.tree.map(jnp.asarray, wanted))
    np.testing.assert_allclose(motors / 60000, expected, rtol=0, atol=2e-4)
    assert np.std(expected, axis=0).min() > 0.005


def turned(roll: float, pitch: float) -> np.ndarray:
    return np.asarray(rotations.from_attitude(jnp.radians(jnp.array([roll, pitch, 40.0]))))


BEYOND = {
    "roll": ({"quaternion": turned(30.2, 0)}, TILT),
    "roll to the left": ({"quaternion": turned(-30.2, 10)}, TILT),
    "nose down": ({"quaternion": turned(5, 30.2)}, TILT),
    "nose up, by the other quaternion": ({"quaternion": -turned(0, -30.2)}, TILT),
    "upside down": ({"quaternion": turned(180, 0)}, TILT),
    "roll rate": ({"gyro": (801, 0, 0)}, BODY_RATE),
    "pitch rate": ({"gyro": (0, -801, 0)}, BODY_RATE),
    "along x": ({"position": (START[0] + 0.61, START[1], 1)}, DISTANCE),
    "below": ({"position": (*START, 0.39)}, DISTANCE),
    "not a position": ({"position": (*START, np.nan)}, NOT_FINITE),
    "no velocity": ({"velocity": (0, np.inf, 0)}, NOT_FINITE),
    "no attitude": ({"quaternion": (0, 0, 0, np.nan)}, NOT_FINITE),
    "not a rate": ({"gyro": (0, 0, -np.inf)}, NOT_FINITE),
    "outside": ({"position": (START[0] + 0.3, START[1], 1)}, FENCE),
    "too high": ({"position": (*START, 1.4)}, CEILING),
    "an estimate that jumps": ({"velocity": (0.6, 0, -0.6)}, ESTIMATE),
    "no attitude at all": ({"quaternion": (0, 0, 0, 0)}, NOT_FINITE),
    "thrust by hand": ({"modes": (ABSOLUTE, ABSOLUTE, 0, 0, 0, ABSOLUTE, 0)}, NO_POSITION),
    "levelled": ({"modes": (0, 0, ABSOLUTE, ABSOLUTE, ABSOLUTE, VELOCITY, 0)}, NO_POSITION),
}


@pytest.mark.parametrize(("changes", "why"), BEYOND.values(), ids=BEYOND)
def test_a_guard_hands_back_at_once_and_for_good(
    load: Load, changes: dict[str, Any], why: int
) -> None:
    app = load()
    app.enable(task=0, fence=0.25, ceiling=1.3)
    assert (app.hover(37)["mode"] == FORCE).all()
    (found,) = app.hover(**changes)
    assert (found["mode"], found["calls"]) == (LEGACY, 2)
    # First the PID forgets; then all of its loops run, whatever the step is.
    assert found["asked"]["thrust"][0] == 0
    assert (found["asked"]["modes"][0] == 0).all()
    assert found["asked"]["step"][:2].tolist() == [0, 0]
    assert (found["asked"]["modes"][1] == hovering(1, **changes)["modes"][0]).all()
    if why != NO_POSITION:
        assert found["thrust"] == HOVER_THRUST
        assert found["torque"].tolist() == [11, 22, 33]
    assert (app.log("active"), app.log("state"), app.log("why")) == (0, 2, why)
    after = app.hover(200)
    assert (after["mode"] == LEGACY).all()
    assert (after["calls"] == 1).all()
    assert after["asked"]["step"][:, 0].tolist() == list(range(1038, 1238))
    assert app.log("why") == why
    app.set(enable=0)
    app.hover()
    assert (app.log("state"), app.log("why")) == (0, why)
    app.set(enable=1)
    app.hover(10)
    assert (app.log("active"), app.log("why")) == (1, 0)


@pytest.mark.parametrize(
    "changes",
    [
        {"quaternion": turned(29.8, -29.8)},
        {"gyro": (799, -799, 1500)},
        {"position": (START[0], START[1] - 0.59, 1)},
        {"modes": (VELOCITY, VELOCITY, ABSOLUTE, 0, 0, VELOCITY, 0)},
    ],
)
def test_within_the_limits_the_policy_flies_on(load: Load, changes: dict[str, Any]) -> None:
    app = load()
    app.enable(task=0)
    assert (app.hover(50, **changes)["mode"] == FORCE).all()


def test_a_battery_that_stays_low_hands_back_and_a_burst_does_not(load: Load) -> None:
    app = load()
    app.enable(task=0)
    for milliseconds, volts in ((40, 2.7), (10, 2.9), (49, 2.7)):
        assert (app.hover(milliseconds, battery=volts)["mode"] == FORCE).all()
    app.hover(battery=2.7)
    assert (app.log("active"), app.log("why")) == (0, BATTERY)


def test_the_time_limit_ends_a_flight(load: Load) -> None:
    app = load()
    app.enable(task=0, time=0.5)
    assert (app.hover(501)["mode"] == FORCE).all()
    app.hover()
    assert (app.log("active"), app.log("why")) == (0, TIME)


def test_the_estimate_must_move_as_the_accelerometer_says(load: Load) -> None:
    """A push of 0.5 g that the estimate follows is flown through; one that it does not, is not."""
    app = load()
    app.enable(task=0)
    pushed = hovering(300, acceleration=(0.5, 0, 0))
    pushed["velocity"][:, 0] = 0.5 * 9.80665 * np.arange(1, 301) / 1000
    assert (app.fly(pushed)["mode"] == FORCE).all()
    pushed = pushed[-1:].repeat(100)
    pushed["acceleration"] = (0, 0, -1)  # as it reads 0, and gravity is taken off
    flown = app.fly(pushed)["mode"] == FORCE
    assert (app.log("active"), app.log("why")) == (0, ESTIMATE)
    # 9.81 m/s2 that leak with 0.2 s come to 0.75 m/s after 96 ms.
    assert flown.sum() == pytest.approx(96, abs=2)


def test_the_fence_stands_where_the_drone_took_off(load: Load) -> None:
    app = load()
    far: dict[str, Any] = {"position": (4.0, 3.0, 1.0)}
    app.set(task=0, x=4.0, y=3.0)
    app.hover(100, thrust=0, **far)
    app.hover(1000 - app.step, **far)
    app.set(enable=1)
    assert (app.hover(20, **far)["mode"] == FORCE).all()
    app.hover(position=(4.0, 4.51, 1.0))
    assert app.log("active") == 0


def test_a_drone_that_hovers_at_another_thrust_than_the_policy_s_is_not_flown(
    tmp_path: Path,
) -> None:
    """The share of full thrust at hover tells mass, thrust law and propellers apart."""
    share = HOVER_THRUST / 60000
    app = App(built(policy_of("pwm"), tmp_path, hover=share))
    app.set(x=START[0], y=START[1])
    for factor, why in ((1.0, 0), (1.2, 0), (1.3, OTHER_DRONE), (0.7, OTHER_DRONE), (0.8, 0)):
        app.set(enable=0)
        app.hover(10, thrust=0)
        app.hover(3000, thrust=factor * HOVER_THRUST)
        app.set(enable=1)
        app.hover(10, thrust=factor * HOVER_THRUST)
        assert (app.log("active"), app.log("why")) == (why == 0, why), factor


def test_the_app_tells_which_policy_and_propellers_it_was_built_for(tmp_path: Path) -> None:
    policy = policy_of("pwm")
    app = App(built(policy, tmp_path, propellers="legacy"))
    assert f"{app.parameters['hash'].value:08x}" == digest(policy)[:8]
    assert app.parameters["propellers"].value == PROPELLERS.index("legacy")


def test_limits_can_be_changed_in_flight(load: Load) -> None:
    app = load()
    app.set(task=0)
    app.until(1000)
    app.set(enable=1, distance=2.0, fence=2.5)
    far: dict[str, Any] = {"position": (START[0] + 1.5, START[1], 1)}
    assert (app.hover(20, **far)["mode"] == FORCE).all()
    app.set(distance=np.nan)
    app.hover(**far)
    assert (app.log("active"), app.log("why")) == (0, DISTANCE)


def test_a_stop_from_the_ground_stops_the_motors(load: Load) -> None:
    app = load()
    app.enable()
    app.hover(15)
    found = app.hover(5, modes=0, thrust=0)
    assert (found["mode"] == LEGACY).all()
    assert (found["thrust"] == 0).all()
    assert (found["torque"] == 0).all()


def test_it_does_not_take_over_where_it_must_not_fly(load: Load) -> None:
    app = load()
    for changes, parameters, why in (
        ({"thrust": 0}, {}, NO_POSITION),
        ({"modes": 0}, {}, NO_POSITION),
        ({"position": (0, 0, 0)}, {}, DISTANCE),
        ({"quaternion": turned(45, 0)}, {}, TILT),
        ({}, {"period": 0.0}, PARAMETERS),
        ({}, {"radius": np.inf}, PARAMETERS),
        ({}, {"task": 3}, PARAMETERS),
        ({}, {"full": 70_000.0}, PARAMETERS),
        ({"modes": (VELOCITY, VELOCITY, ABSOLUTE, 0, 0, 0, 0)}, {"task": 2}, NO_POSITION),
    ):
        usual = {name: app.parameters[name].value for name in parameters}
        app.set(enable=0, **parameters)
        app.hover(100, **changes)
        app.set(enable=1)
        found = app.hover(30, **changes)
        assert (found["mode"] == LEGACY).all()
        assert (found["calls"] == 1).all()
        assert (app.log("active"), app.log("state"), app.log("why")) == (0, 2, why), (
            changes,
            parameters,
        )
        app.set(**usual)


def test_every_take_over_is_like_the_first(load: Load) -> None:
    app, wander = load(), hovering(80)
    wander["position"][:, 0] += np.linspace(0, 0.2, 80)
    app.enable()
    first = app.fly(wander)
    app.set(enable=0)
    (back,) = app.hover()
    assert (back["mode"], back["calls"], app.log("why")) == (LEGACY, 2, DISABLED)
    assert back["thrust"] == HOVER_THRUST
    app.until(2000)
    app.set(enable=1)
    again = app.fly(wander)
    assert (again["mode"] == FORCE).all()
    assert np.array_equal(first["forces"], again["forces"])
    assert len(np.unique(first["forces"], axis=0)) == 8


def test_it_takes_over_within_ten_steps_where_the_position_loop_runs(load: Load) -> None:
    app = load()
    app.until(1003)
    app.set(enable=1)
    assert app.hover(10)["mode"].tolist() == [LEGACY] * 7 + [FORCE] * 3


def test_set_points_on_board(load: Load) -> None:
    app = load()
    app.until(1000)
    app.set(enable=1, radius=0.3, period=1.2, ramp=0.0, height=1.1)
    for milliseconds, place in (
        (1, (0, 0)),
        (300, (0.3, 0.3)),
        (300, (0.6, 0)),
        (300, (0.3, -0.3)),
        (300, (0, 0)),
    ):
        app.hover(milliseconds, position=(START[0] + 0.3, START[1], 1.0))
        goal = [app.log(f"goal{axis}") for axis in "XYZ"]
        np.testing.assert_allclose(goal, [START[0] + place[0], START[1] + place[1], 1.1], atol=1e-5)
        app.set(radius=0.1, height=0.5)  # of consequence only when it takes over again
    app.set(enable=0, task=2)
    app.hover()
    app.set(enable=1)
    app.hover(20, wanted=(0.6, -0.3, 1.2))
    np.testing.assert_allclose([app.log(f"goal{axis}") for axis in "XYZ"], [0.6, -0.3, 1.2])
    assert app.log("active") == 1


def test_a_controller_chosen_in_flight_waits_until_it_is_enabled_anew(load: Load) -> None:
    app = load()
    app.enable()
    app.hover(5)
    app.library.controllerOutOfTreeInit()
    assert (app.log("active"), app.log("why")) == (0, SWITCHED_AWAY)
    found = app.hover(50)
    assert (found["mode"] == LEGACY).all()
    assert (found["thrust"] == HOVER_THRUST).all()
    app.set(enable=0)
    app.hover()
    app.set(enable=1)
    app.hover(10)
    assert app.log("active") == 1


def test_the_app_s_own_task_sees_that_another_controller_was_chosen(load: Load) -> None:
    app = load()
    app.enable()
    app.hover(10)
    period = app.run_app()
    for _ in range(3):
        app.hover(period)
        app.run_app()
        assert (app.log("active"), app.log("why")) == (1, 0)
    app.run_app()  # the stabilizer has not called since
    assert (app.log("active"), app.log("state"), app.log("why")) == (0, 2, SWITCHED_AWAY)
    # The firmware initialises it when it is chosen again.
    app.library.controllerOutOfTreeInit()
    assert (app.hover(50)["mode"] == LEGACY).all()
    assert app.log("why") == SWITCHED_AWAY
    app.set(enable=0)
    app.hover()
    app.set(enable=1)
    app.hover(period)
    app.run_app()
    assert (app.log("active"), app.log("why")) == (1, 0)


def test_the_app_s_own_task_says_nothing_while_the_pid_flies(load: Load) -> None:
    app = load()
    for _ in range(3):
        app.run_app()
    assert (app.log("state"), app.log("why")) == (0, 0)


@pytest.mark.parametrize("table", ["observation_mean", "observation_std", "weights"])
def test_a_policy_with_one_bit_turned_does_not_fly(load: Load, table: str) -> None:
    policy = policy_of("pwm")
    # Weights lie four rows together. Small tables, such as the biases here, a compiler may write
    # into the code instead.
    numbers = (
        np.asarray(policy.weights[0])[:4].T
        if table == "weights"
        else np.asarray(getattr(policy, table))
    ).tobytes()

    def turn(image: bytes) -> bytes:
        assert image.count(numbers) == 1
        place = image.index(numbers)
        return image[:place] + bytes([image[place] ^ 1]) + image[place + 1 :]

    app = load(damage=turn)
    assert not app.test()
    app.enable()
    assert (app.hover(20)["mode"] == LEGACY).all()
    assert app.log("why") == SELF_TEST
    assert load().test()


def test_the_pid_s_own_test_counts(load: Load) -> None:
    app = load()
    ctypes.c_bool.in_dll(app.library, "pid_sound").value = False
    assert not app.test()
    assert ctypes.c_int.in_dll(app.library, "pid_begun").value == 1


def test_the_page_and_the_tables_name_the_same(load: Load) -> None:
    app = load()
    (page,) = re.findall(r"^## The app\n(.*?)^## ", PAGE.read_text(), re.M | re.S)
    named = re.findall(r"^\| `mf\.(\w+)` \| (\S+) \|", page, re.M)
    defaults, kinds = dict(named[: len(app.parameters)]), dict(named[len(app.parameters) :])
    app.set(x=0, y=0)
    app.parameters["hash"].value = 0
    assert list(defaults) == list(app.parameters)
    for name, value in defaults.items():
        assert app.parameters[name].value == pytest.approx(float(value)), name
    assert list(kinds) == list(app.logs)
    for name, kind in kinds.items():
        assert {"uint8": ctypes.c_uint8, "uint32": ctypes.c_uint32, "float": ctypes.c_float}[
            kind
        ] is type(app.logs[name]), name
    reasons = re.findall(r"^\| (\d+) \| ", page, re.M)
    assert reasons == [str(reason) for reason in range(1, OTHER_DRONE + 1)]
    assert len(REASONS) == OTHER_DRONE + 1

    assert ENABLE.removeprefix("mf.") in app.parameters
    assert ACTIVE.removeprefix("mf.") in app.logs


def test_what_the_drone_cannot_fly_is_refused(tmp_path: Path) -> None:
    policy = policy_of("pwm")
    large = untrained_policy(jax.random.key(0), spec=PolicySpec(history=2, hidden=(90, 90)))
    assert sum(weight.size for weight in large.weights) > MOST_MULTIPLICATIONS
    for wrong, message in (
        (dataclasses.replace(policy, interface=interface.pwm(30)), "rate = 30 Hz does not divide"),
        (
            dataclasses.replace(
                policy, interface=dataclasses.replace(interface.pwm(), name="motor")
            ),
            "control = 'motor'",
        ),
        (large, "12060 multiplications"),
    ):
        with pytest.raises(InputError, match=message):
            export_crazyflie(wrong, tmp_path)
    assert not list(tmp_path.iterdir())


def test_the_same_policy_gives_the_same_files(tmp_path: Path) -> None:
    meaning = interface.pwm(full_scale_counts=65535.0)
    identified = dataclasses.replace(policy_of("pwm"), interface=meaning)

    def exported(folder: Path) -> dict[str, bytes]:
        return {
            str(file.relative_to(folder)): file.read_bytes()
            for file in export_crazyflie(identified, folder)
        }

    once = exported(tmp_path / "once")
    assert once == exported(tmp_path / "again")
    app = {
        "Makefile",
        "Kbuild",
        "app-config",
        "README.md",
        "src/Kbuild",
        "src/maidenflight.c",
        "src/policy.c",
        "src/policy.h",
    }
    assert set(once) == app
    assert b"static float full = 65535.0f;" in once["src/maidenflight.c"]
    assert not any(
        re.search(rb"\$[a-z]", text) for name, text in once.items() if name != "Makefile"
    )
