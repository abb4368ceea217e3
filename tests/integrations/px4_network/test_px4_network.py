"""PX4's `mc_nn_control`: what it sees, what becomes of outputs, and the network it is built of.

A reader of the model from TensorFlow Lite's schema accepts only what the module's interpreter has;
where LiteRT is installed, its interpreter computes the same.
"""

import importlib
import re
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from maidenflight.deployment import export
from maidenflight.errors import InputError
from maidenflight.integrations.px4_network import form
from maidenflight.integrations.px4_network.export import PARAMETERS, export_px4, layers_of
from maidenflight.integrations.raptor.px4 import CONTROLS
from maidenflight.policy import Policy, untrained_policy
from maidenflight.simulator.controllers import interface
from maidenflight.simulator.policy_spec import PolicySpec

tflite: Any = pytest.importorskip("tflite", reason="not installed (extra [px4])")
ARENA = 10 * 1024
"""Bytes that the module has for the network's values."""
ACTION, OUTPUT = jax.jit(form.action_of), jax.jit(form.output_of)


def made() -> Policy:
    """A policy with outputs of some size, unlike each other."""
    one = untrained_policy(jax.random.key(0), spec=PolicySpec(form="px4"))
    weights, biases, gru = one.network
    last = biases[-1] + jnp.array([0.1, -0.2, 0.3, -0.4])
    return one.with_network(((*weights[:-1], 5.0 * weights[-1]), (*biases[:-1], last), gru))


def observations(count: int) -> np.ndarray:
    """Observations of ours, of drones near their set-point."""
    random = np.random.default_rng(0)
    turned = Rotation.from_rotvec(0.4 * random.normal(size=(count, 3))).as_quat()
    rest = random.normal(size=(count, 16)) * 0.5
    return np.concatenate([rest[:, :3], turned, rest[:, 3:]], axis=1).astype(np.float32)


def module_inputs(observation: np.ndarray) -> np.ndarray:
    """The module's `PopulateInputTensor`, of NED and FRD, as documented there."""
    position, quaternion, velocity, rates, error, _ = np.split(observation, [3, 7, 10, 13, 16])
    to_ned = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1.0]])  # of east, north, up
    to_frd = np.diag([1.0, -1.0, -1.0])
    ned = [to_ned @ one for one in (position, position + error, velocity)]
    attitude = to_ned @ Rotation.from_quat(quaternion).as_matrix() @ to_frd.T
    first, second = np.diag([1.0, -1.0, -1.0]), np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])
    at, wanted, moving = (first @ second @ one for one in ned)
    turned = first @ (second @ attitude) @ first.T
    return np.concatenate([wanted - at, turned[0], turned[1], moving, first @ (to_frd @ rates)])


def test_it_sees_what_the_module_puts_into_its_input() -> None:
    for observation in observations(20):
        found = form.observed(jnp.asarray(observation))
        np.testing.assert_allclose(found, module_inputs(observation), atol=2e-6)


def rescaled(action: np.ndarray) -> np.ndarray:
    """The module's motor command of an output, by the parameters that are exported."""
    values = {name: float(value) for name, value, _ in PARAMETERS}
    coefficient = values["MC_NN_THRST_COEF"] / 100000.0
    least, most = values["MC_NN_MIN_RPM"], values["MC_NN_MAX_RPM"]
    rpm = 60.0 * np.sqrt((np.clip(action, -1.0, 1.0) + 1.0) / coefficient)
    x = np.clip((rpm - least) / (most - least), 0.0, 1.0)
    return 0.8 * x**2 + 0.2 * x


@given(st.lists(st.floats(-3.0, 3.0, width=32), min_size=4, max_size=4).map(np.array))
def test_an_output_commands_what_the_module_makes_of_it_and_is_seen_again(output: Any) -> None:
    action = ACTION(jnp.asarray(output, jnp.float32))
    np.testing.assert_allclose(interface.pwm().command(action), rescaled(output), atol=2e-5)
    clipped = np.clip(output, -1.0, 1.0)
    np.testing.assert_allclose(OUTPUT(action), clipped, atol=1e-5)


@pytest.mark.parametrize("output", [-2.0, -1.0, 0.0, 1.0, 2.0])
def test_every_slope_is_finite(output: float) -> None:
    slope = jax.grad(lambda one: jnp.sum(ACTION(one)))(jnp.full(4, output))
    assert np.isfinite(slope).all()


def evaluate(model: bytes, inputs: np.ndarray) -> np.ndarray:
    """Reads the model by its schema, strictly, and computes it in float32."""
    assert model[4:8] == b"TFL3"
    read = tflite.Model.GetRootAsModel(model, 0)
    assert read.Version() == 3
    assert read.SubgraphsLength() == read.OperatorCodesLength() == 1
    code = read.OperatorCodes(0)
    assert code.BuiltinCode() == code.DeprecatedBuiltinCode() == 9
    graph = read.Subgraphs(0)
    values: dict[int, np.ndarray] = {graph.Inputs(0): inputs}
    sizes = 0
    for number in range(graph.TensorsLength()):
        tensor = graph.Tensors(number)
        assert tensor.Type() == tflite.TensorType.FLOAT32
        shape, buffer = tensor.ShapeAsNumpy(), read.Buffers(tensor.Buffer())
        sizes += 4 * int(np.prod(shape)) if tensor.Buffer() == 0 else 0
        if tensor.Buffer():
            data = buffer.DataAsNumpy()
            assert data.size == 4 * np.prod(shape)
            place = np.frombuffer(model, np.uint8)
            assert (data.__array_interface__["data"][0] - place.ctypes.data) % 16 == 0
            values[number] = data.view("<f4").reshape(shape)
    assert sizes < ARENA
    for number in range(graph.OperatorsLength()):
        operator = graph.Operators(number)
        options = tflite.FullyConnectedOptions()
        table = operator.BuiltinOptions()
        options.Init(table.Bytes, table.Pos)
        source, weights, biases = (values[one] for one in operator.InputsAsNumpy())
        result = source @ weights.T + biases
        is_last = number == graph.OperatorsLength() - 1
        assert options.FusedActivationFunction() == (0 if is_last else 1)
        values[operator.Outputs(0)] = result if is_last else np.maximum(result, 0.0)
    return values[graph.Outputs(0)]


def litert(model: bytes, inputs: np.ndarray) -> np.ndarray:
    """LiteRT's interpreter, one row at a time."""
    pytest.importorskip("ai_edge_litert", reason="not on this machine: pip install ai-edge-litert")
    package: Any = importlib.import_module("ai_edge_litert.interpreter")
    interpreter = package.Interpreter(model_content=model)
    interpreter.allocate_tensors()
    (source,), (target,) = interpreter.get_input_details(), interpreter.get_output_details()
    assert source["shape"].tolist() == [1, 15]
    rows = []
    for row in inputs:
        interpreter.set_tensor(source["index"], row[None])
        interpreter.invoke()
        rows.append(interpreter.get_tensor(target["index"])[0])
    return np.array(rows)


@pytest.mark.parametrize("read", [evaluate, litert])
def test_a_reader_computes_what_the_policy_does_to_1e_6_in_px4s_order(
    read: Any, tmp_path: Path
) -> None:
    policy = made()
    path, *_ = export_px4(policy, tmp_path)
    seen = observations(40)
    inputs = np.array([form.observed(jnp.asarray(one)) for one in seen], np.float32)
    found = np.asarray(read(path.read_bytes(), inputs))
    actions = np.array([policy(jnp.asarray(one)) for one in seen])
    assert np.abs(found).max() > 1.0
    ours = np.empty_like(found)
    ours[:, list(CONTROLS)] = found
    expected = np.array([form.action_of(jnp.asarray(one)) for one in ours])
    scale = np.maximum(np.abs(actions), 1.0)
    assert np.max(np.abs(expected - actions) / scale) < 2e-6


def test_the_sources_hold_the_model_and_parameters_lie_in_px4s_ranges(tmp_path: Path) -> None:
    files = export(made(), tmp_path, "px4", name="policy_1")
    model, source, header, parameters = (file.read_bytes() for file in files)
    array = re.findall(rb"0x([0-9a-f]{2}),", source)
    assert bytes(int(byte, 16) for byte in array) == model
    assert f"control_net_tflite_size = {len(model)};".encode() in header
    lines = [line.split("\t") for line in parameters.decode().splitlines() if line[0] != "#"]
    assert [(line[2], line[3], int(line[4])) for line in lines] == list(PARAMETERS)
    ranges = {"MC_NN_THRST_COEF": (0.01, 5), "MC_NN_MIN_RPM": (0, 8e4), "MC_NN_MAX_RPM": (0, 8e4)}
    for _, _, name, value, _ in lines:
        least, most = ranges.pop(name)
        assert least <= float(value) <= most
    assert not ranges


def test_another_form_is_refused_and_this_one_elsewhere(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--form px4"):
        export_px4(untrained_policy(jax.random.key(0)), tmp_path)
    with pytest.raises(InputError, match="--to px4 only"):
        export(made(), tmp_path, "c")
    assert [table.shape for table, _ in layers_of(made())] == [(64, 15), (64, 64), (4, 64)]
