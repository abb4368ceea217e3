"""What a policy's outputs mean is the same in flight and in everything that is exported."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_c import COMPILERS, SimulatedFlight

import maidenflight as mf
from maidenflight import policy
from maidenflight.deployment import export
from maidenflight.deployment.commands import described
from maidenflight.errors import InputError
from maidenflight.integrations.exporters.authors_json import export_authors_json
from maidenflight.integrations.exporters.crazyflie_app import drives, export_crazyflie
from maidenflight.parameters import crazyflie, noiseless, replace
from maidenflight.policy import Actor, Policy
from maidenflight.registry import EXPORTERS
from maidenflight.simulator import environment
from maidenflight.simulator.controllers import control, interface
from maidenflight.simulator.controllers.interface import THRUST, ControlInterface
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.stepping import rollout

ROLL = 0.25
"""Action of roll: a quarter of the highest rate."""
KEY = jax.random.key(0)
LEVEL = Measurement(
    jnp.array([0.0, 0.0, 1.0]), jnp.zeros(3), jnp.array([0.0, 0.0, 0.0, 1.0]), jnp.zeros(3)
)
WINCH = ControlInterface(
    "winch", (0.4, 0.1, 1.0, -2.0), (0.2, 3.0, 0.5, 4.0), (THRUST, "N m", "rad", "m/s"), 50, 65535.0
)


def constant(meaning: ControlInterface, action: list[float]) -> Policy:
    """A policy that always does the same."""
    made = jax.tree.map(
        jnp.zeros_like, policy.untrained_policy(KEY, meaning, PolicySpec(history=1, hidden=()))
    )
    return dataclasses.replace(
        made, biases=(jnp.array(action, jnp.float32),), observation_std=jnp.ones(20)
    )


def in_c(made: Policy, folder) -> np.ndarray:
    """The exported code's first command for a level drone."""
    mf.export(made, folder)
    drone = SimulatedFlight(folder, made.spec.history)
    drone.reset(np.zeros(4))
    finite, command = drone.step(LEVEL, LEVEL.position)
    assert finite
    assert drone.self_test()
    return command


def in_onnx(made: Policy) -> np.ndarray:
    """The exported model's command for a level drone."""
    runtime = pytest.importorskip("onnxruntime")
    from maidenflight.integrations.exporters.onnx import to_onnx

    session = runtime.InferenceSession(to_onnx(made))
    seen = np.asarray(environment.observe(LEVEL, LEVEL.position, jnp.zeros(4)))[None]
    return session.run(["command"], {"observation": seen})[0][0]


@pytest.mark.slow
@pytest.mark.skipif(not COMPILERS, reason="no C compiler")
def test_exported_code_asks_for_the_body_rate_that_the_simulated_drone_reaches(tmp_path):
    """360 deg/s: a quarter of it is 90, which was exported as 15."""
    controller = mf.simulator.attitude_rate(highest_rate=360.0)
    drone = replace(noiseless(crazyflie()), latency=0.005, time_step=0.002)
    level = controller.interface.level(dynamics.hover_command(drone))
    made = constant(controller.interface, [float(level[0]), ROLL, 0.0, 0.0])
    env = Environment.matching(drone, controller=controller, spec=PolicySpec(history=1))
    first = environment.begin(
        env, dynamics.at_hover(LEVEL.position, drone), jnp.zeros(()), drone, KEY
    )
    _, (flown, _) = jax.jit(lambda: rollout(env, made, first, drone, KEY, 20))()
    reached = np.asarray(flown.state.body_rates)[12:, 0].mean()
    command = in_c(made, tmp_path)
    assert command[1] == pytest.approx(np.radians(90.0), rel=1e-6)
    assert reached == pytest.approx(command[1], rel=0.05)
    np.testing.assert_allclose(in_onnx(made), command, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(
        Actor(made, 0.6).act(LEVEL, LEVEL.position).command, command, rtol=1e-6, atol=1e-7
    )


@pytest.mark.skipif(not COMPILERS, reason="no C compiler")
@pytest.mark.parametrize(
    "meaning",
    [WINCH, *(make(full_scale_counts=65535.0) for make in interface.INTERFACES.values())],
    ids=lambda meaning: meaning.name,
)
def test_what_drives_the_motors_is_given_what_is_exported(meaning, tmp_path):
    given = []
    spied = control.driven(meaning, lambda memory, wanted, *_: (given.append(wanted), wanted))
    made = constant(meaning, [0.3, -0.7, 1.5, -0.1])
    action = made(jnp.zeros(20))
    spied.command(None, action, LEVEL, LEVEL.position)
    np.testing.assert_allclose(in_c(made, tmp_path), given[0], rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(in_onnx(made), given[0], rtol=1e-6, atol=1e-7)


def test_a_controller_of_one_s_own_is_exported_as_itself(tmp_path):
    onnx = pytest.importorskip("onnx")
    made = constant(WINCH, [0.0] * 4)
    header, _ = (file.read_text() for file in export(made, tmp_path, "c", seed=1, record={}))
    words = " ".join(header.replace("\n *", " ").split())
    assert '#define MF_CONTROL "winch"' in header
    assert "#define MF_RATE 50" in header
    assert " ".join(described(WINCH).split()) in words
    for told in ("-2.9 to 3.1 N m", "-6 to 2 m/s", "65535 of the firmware's"):
        assert told in words
    (file,) = export(made, tmp_path, "onnx", name="winch", seed=1, record={})
    told = {entry.key: entry.value for entry in onnx.load(file).metadata_props}
    assert ControlInterface.from_dict(json.loads(told["interface"])) == WINCH
    assert told["command"] == described(WINCH)
    assert "$" not in "".join(told.values())


def test_what_a_target_cannot_express_is_refused(tmp_path):
    for write in (export_authors_json, export_crazyflie):
        with pytest.raises(InputError, match="winch"):
            write(constant(WINCH, [0.0] * 4), tmp_path)
    wide = constant(interface.attitude_rate(highest_rate=360.0), [0.0] * 4)
    with pytest.raises(InputError, match="span"):
        export_authors_json(wide, tmp_path)
    assert not list(tmp_path.iterdir())
    assert drives() == sorted(interface.INTERFACES)


@pytest.mark.parametrize("name", EXPORTERS.own)
def test_every_exporter_takes_the_same_call(name, tmp_path):
    if name == "onnx":
        pytest.importorskip("onnx")
    made = policy.untrained_policy(KEY, spec=PolicySpec(hidden=(3,)))
    if name in ("raptor", "px4"):
        pytest.importorskip({"raptor": "h5py", "px4": "tflite"}[name])
        made = policy.untrained_policy(KEY, spec=PolicySpec(form=name))
    files = export(made, tmp_path, name, name="mine", seed=3, record={"seed": 3})
    assert files
    assert all(file.is_relative_to(tmp_path) and file.stat().st_size for file in files)


def test_a_policy_of_another_name_flies_with_its_own_controller_only():
    made = constant(WINCH, [0.0] * 4)
    with pytest.raises(InputError, match="winch"):
        mf.transfer([made], [mf.virtual_drone(7)])
    with pytest.raises(InputError, match="winch"):
        mf.transfer([made], [mf.virtual_drone(7)], controller=mf.simulator.pwm())
