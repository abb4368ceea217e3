"""A policy of RAPTOR's form as a checkpoint of RL-tools, which programs for RAPTOR read.

Needs `h5py`, which the extra `raptor` brings. The file is HDF5: the group `actor` has a dense layer
with ReLU, a gated recurrent unit and a dense layer, and `example` inputs and outputs by which a
reader checks its arithmetic. The scaling of observations is folded into the first layer.

Source: layout of the checkpoint in foundation-policy 1.0.2 (Eschmann et al. 2025, RAPTOR).
"""

import importlib
import io
import json
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from maidenflight import __version__
from maidenflight.deployment.c import digest, remembered
from maidenflight.errors import InputError, optional
from maidenflight.integrations.raptor.form import RAPTOR
from maidenflight.policy import Policy
from maidenflight.simulator.policy_spec import ACTION_SIZE

MAKER = "maidenflight"
"""Attribute of the file that tells how it was made; readers ignore it."""
META = (
    '{"environment": {"name": "l2f","observation": "Position.OrientationRotationMatrix.'
    'LinearVelocity.AngularVelocityDelayed(0).ActionHistory(1)"}}'
)
"""What the checkpoint of RAPTOR says of its inputs."""
EXAMPLE = (100, 2)
"""Instants of the example, and sequences."""
_SPREAD = np.array([0.1] * 3 + [0.3] * 3 + [1.0] * 3)
"""Of the example's positions [m], velocities [m/s] and body rates [rad/s]."""
_TURN = 0.3
"""Of the angles by which it is turned about each axis [rad]."""

Numbers = NDArray[np.float32]


def to_raptor(
    policy: Policy, name: str = "policy", seed: int = 0, record: Mapping[str, Any] | None = None
) -> bytes:
    """Returns the bytes of a checkpoint. The same arguments give the same bytes.

    Args:
        policy: a policy of RAPTOR's form.
        name: which the checkpoint bears.
        seed: random seed of the example.
        record: how the policy was made, for the attribute `MAKER`.

    Raises:
        InputError: `h5py` is not installed, or the policy makes no sense or is of another form.
    """
    with optional("h5py", "raptor", "a checkpoint of RL-tools"):
        h5py: Any = importlib.import_module("h5py")
    policy.check()
    if policy.spec.form != RAPTOR:
        raise InputError(
            f"policy: of the form {policy.spec.form}; a program for RAPTOR flies policies of its "
            "form only. Train one: maidenflight train --form raptor."
        )
    layers = layers_of(policy)
    observations, outputs = example(policy, seed)
    attributes = {"version": __version__, "sha256": digest(policy), "record": dict(record or {})}
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        file.attrs[MAKER] = json.dumps(attributes)
        actor = file.create_group("actor")
        actor.attrs.update({"type": "sequential", "checkpoint_name": name, "meta": META})
        for number, (kind, activation, tables) in enumerate(layers):
            layer = actor.create_group(f"layers/{number}")
            layer.attrs["type"] = kind
            if activation:
                layer.attrs["activation_function"] = activation
            for parameter, numbers in tables.items():
                _store(layer, f"{parameter}/parameters", numbers, matrix=kind == "dense")
        _store(file, "example/input", observations)
        _store(file, "example/output", outputs)
    return content.getvalue()


Layer = tuple[str, str, dict[str, Numbers]]
"""Type, activation function or nothing, and tables by their names in the file."""


def layers_of(policy: Policy) -> list[Layer]:
    """Returns the layers of a policy, with the scaling of observations in the first.

    Raises:
        InputError: a scaled weight is too large for float32.
    """
    weights, biases = folded(policy)
    gru: Any = policy.gru
    unit = {
        "biases_hidden": gru.recurrent_biases,
        "biases_input": gru.biases,
        "initial_hidden_state": np.zeros(gru.size, np.float32),
        "weights_hidden": gru.recurrent,
        "weights_input": gru.weights,
    }
    last = {"weights": policy.weights[1], "biases": policy.biases[1][None]}
    return [
        ("dense", "RELU", {"weights": weights, "biases": biases[None]}),
        ("gru", "", {name: np.asarray(numbers) for name, numbers in unit.items()}),
        ("dense", "IDENTITY", {name: np.asarray(numbers) for name, numbers in last.items()}),
    ]


def folded(policy: Policy) -> tuple[Numbers, Numbers]:
    """Returns weights and biases of a first layer that sees what is not scaled.

    Raises:
        InputError: one is too large for float32.
    """
    tables = policy.weights[0], policy.biases[0], policy.observation_mean, policy.observation_std
    weights, biases, mean, deviation = (np.asarray(table, np.float64) for table in tables)
    scaled = weights / deviation
    shifted = biases - scaled @ mean
    if max(np.abs(scaled).max(), np.abs(shifted).max()) > np.finfo(np.float32).max:
        raise InputError("policy: a weight overflows float32. Training diverged: train again.")
    return scaled.astype(np.float32), shifted.astype(np.float32)


def network_of(policy: Policy) -> Callable[[Any, Any], tuple[NDArray[Any], NDArray[Any]]]:
    """Returns the network in float64: inputs, (B, 22), and memory, (B, M), to outputs and memory.

    Raises:
        InputError: see `folded`.
    """
    weights, biases = (numbers.astype(np.float64) for numbers in folded(policy))
    last, level = (np.asarray(each[1], np.float64) for each in (policy.weights, policy.biases))
    gru: Any = policy.gru

    def respond(inputs: Any, memory: Any) -> tuple[NDArray[Any], NDArray[Any]]:
        memory = remembered(gru, np.maximum(inputs @ weights.T + biases, 0.0), memory)
        return memory @ last.T + level, memory

    return respond


def example(policy: Policy, seed: int) -> tuple[Numbers, Numbers]:
    """Inputs such as a drone near its set-point gives, (T, B, 22), and the outputs, (T, B, 4).

    The last action is the output before, and zero at first. Outputs are summed in float64.

    Raises:
        InputError: an output is too large for float32.
    """
    random = np.random.default_rng(seed)
    (length, batch), respond = EXAMPLE, network_of(policy)
    memory, output = np.zeros((batch, policy.spec.memory)), np.zeros((batch, ACTION_SIZE))
    inputs, outputs = [], []
    for _ in range(length):
        position, velocity, rates = np.split(_SPREAD * random.normal(size=(batch, 9)), 3, axis=1)
        turned = Rotation.from_rotvec(_TURN * random.normal(size=(batch, 3))).as_matrix()
        parts = [position, turned.reshape(batch, 9), velocity, rates, np.clip(output, -1.0, 1.0)]
        inputs.append(np.concatenate(parts, axis=1).astype(np.float32))
        output, memory = respond(inputs[-1], memory)
        outputs.append(output)
    if not np.all(np.abs(outputs) < np.finfo(np.float32).max):
        raise InputError("policy: an action overflows float32. Training diverged: train again.")
    return np.stack(inputs), np.stack(outputs).astype(np.float32)


def _store(group: Any, path: str, numbers: Numbers, matrix: bool = False) -> None:
    """Writes a table with the attributes by which RL-tools knows its shape."""
    table = group.create_dataset(path, data=numbers)
    if matrix:
        shape = {"rows": str(numbers.shape[0]), "cols": str(numbers.shape[1])}
        table.attrs.update({"type": "matrix", **shape})
    else:
        sizes = {f"dim_{axis}": str(size) for axis, size in enumerate(numbers.shape)}
        table.attrs.update({"type": "tensor", "num_dims": str(numbers.ndim), **sizes})
