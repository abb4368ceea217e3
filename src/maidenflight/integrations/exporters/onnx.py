"""A policy as ONNX, with the scaling of observations and commands in its graph.

Needs the `onnx` package, an extra. Runtimes from 2022 on read the version of the format.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from maidenflight import __version__, results
from maidenflight.deployment.c import digest, golden_observations
from maidenflight.deployment.commands import check_form, check_hover, described
from maidenflight.errors import InputError, optional
from maidenflight.inputs import StrPath
from maidenflight.policy import Policy
from maidenflight.simulator.policy_spec import ACTION_SIZE, INSTANT

NAME = "policy.onnx"
OPSET = 17
"""Version of the operators; onnxruntime 1.12 knows it."""
IR = 8
"""Version of the file format."""


def to_onnx(
    policy: Policy, record: Mapping[str, Any] | None = None, hover: float | None = None
) -> bytes:
    """Returns the bytes of an ONNX model. The same arguments give the same bytes.

    Input: `observation`, float32 (batch, 20 H + 3 K), SI units, laid out as `policy_spec.INSTANT`,
    oldest instant first, then the K points of a look-ahead. Outputs: `command`, float32 (batch, 4),
    centre + span clip(a, -1, 1) of the policy's interface; and `action`, float32 (batch, 4), the
    unclipped a, which the next observation holds. Both are NaN in rows whose observation or action
    is not finite; ReLU and clipping would hide that.

    A policy that remembers has a second input, `memory`, float32 (batch, M), zeros in a flight's
    first step, and a third output, `next_memory`, which is the next step's.

    Args:
        policy: the policy.
        record: how the policy was made, for the metadata.
        hover: share of full thrust at which the drone hovers, 1 / thrust_to_weight, for the
            metadata; not there by default.

    Raises:
        InputError: the `onnx` package is not installed, the policy or the share makes no sense, or
            the policy is of RAPTOR's form.
    """
    with optional("onnx", "onnx", "an ONNX export"):
        from onnx import TensorProto, helper, numpy_helper
    _check(policy)
    check_hover(hover)
    command, memory = described(policy.interface), policy.spec.memory

    def table(name: str, columns: int, comment: str) -> Any:
        return helper.make_tensor_value_info(
            name, TensorProto.FLOAT, ["batch", columns], doc_string=comment
        )

    nodes = [
        helper.make_node(operator, input_names.split(), output_names.split(), **attributes)
        for operator, input_names, output_names, attributes in _steps(policy)
    ]
    inputs = [table("observation", policy.layer_sizes[0], policy.spec.layout)]
    outputs = [
        table("command", ACTION_SIZE, command),
        table("action", ACTION_SIZE, "not clipped; the next observation holds it"),
    ]
    if memory:
        inputs.append(table("memory", memory, "zeros in the first step"))
        outputs.append(table("next_memory", memory, "the next step's memory"))
    numbers = [numpy_helper.from_array(value, name) for name, value in _constants(policy).items()]
    model = helper.make_model(
        helper.make_graph(nodes, "policy", inputs, outputs, numbers),
        producer_name="maidenflight",
        producer_version=__version__,
        ir_version=IR,
        opset_imports=[helper.make_opsetid("", OPSET)],
    )
    metadata = {
        "version": __version__,
        "interface": json.dumps(policy.interface.to_dict()),
        **{name: json.dumps(value) for name, value in policy.spec.to_dict().items()},
        "instant": INSTANT,
        "command": command,
        "sha256": digest(policy),
        "record": json.dumps(dict(record or {})),
    }
    metadata |= {} if hover is None else {"hover": f"{np.float32(hover)!s}"}
    del metadata["hidden"]
    helper.set_model_props(model, metadata)
    return model.SerializeToString(deterministic=True)


def export_onnx(
    policy: Policy,
    directory: StrPath,
    *,
    hover: float | None = None,
    record: Mapping[str, Any] | None = None,
) -> list[Path]:
    """Writes a policy as `policy.onnx`; see `to_onnx`.

    Args:
        policy: the policy.
        directory: where to write; made if missing.
        hover: see `to_onnx`.
        record: how the policy was made, for the metadata.

    Returns:
        The file written, alone in a list.

    Raises:
        InputError: the `onnx` package is not installed, the policy or the share makes no sense, or
            the directory cannot be written.
    """
    return [results.write(Path(directory) / NAME, to_onnx(policy, record, hover))]


def _check(policy: Policy) -> None:
    policy.check()
    check_form(policy)
    outputs = jax.jit(jax.vmap(policy))(jnp.asarray(golden_observations(policy, 0)))
    if not np.isfinite(outputs).all():
        raise InputError("policy: an action overflows float32. Training diverged: train again.")


_RECURRENT: list[tuple[str, str, str, dict[str, Any]]] = [
    ("Gemm", "hidden_1 recurrent_weights recurrent_biases", "given", {"transB": 1}),
    ("Gemm", "memory memory_weights memory_biases", "known", {"transB": 1}),
    ("Split", "given thirds", "given_reset given_update given_candidate", {"axis": 1}),
    ("Split", "known thirds", "known_reset known_update known_candidate", {"axis": 1}),
    ("Add", "given_reset known_reset", "reset_sum", {}),
    ("Sigmoid", "reset_sum", "reset", {}),
    ("Add", "given_update known_update", "update_sum", {}),
    ("Sigmoid", "update_sum", "update", {}),
    ("Mul", "reset known_candidate", "known_share", {}),
    ("Add", "given_candidate known_share", "candidate_sum", {}),
    ("Tanh", "candidate_sum", "candidate", {}),
    ("Sub", "memory candidate", "change", {}),
    ("Mul", "update change", "kept", {}),
    ("Add", "candidate kept", "remembered", {}),
    ("Concat", "hidden_1 remembered", "hidden_and_memory", {"axis": 1}),
]
"""The gated recurrent unit of one step; ONNX's own operator is for whole sequences."""


def _steps(policy: Policy) -> list[tuple[str, str, str, dict[str, Any]]]:
    """The graph of a network: operator, inputs, outputs, its attributes."""
    layers, remembers = len(policy.weights), policy.gru is not None
    steps: list[tuple[str, str, str, dict[str, Any]]] = [
        ("Sub", "observation mean", "centred", {}),
        ("Div", "centred deviation", "scaled", {}),
    ]
    values = "scaled"
    for number in range(1, layers + 1):
        steps.append(
            ("Gemm", f"{values} weights_{number} biases_{number}", f"layer_{number}", {"transB": 1})
        )
        values = f"layer_{number}"
        if number < layers:
            steps.append(("Relu", values, f"hidden_{number}", {}))
            values = f"hidden_{number}"
        if remembers and number == 1:
            steps += _RECURRENT
            values = "hidden_and_memory"
    inputs = "observation memory remembered" if remembers else "observation"
    return [
        *steps,
        # Zero, or NaN where a number is not finite.
        ("Concat", f"{inputs} {values}", "numbers", {"axis": 1}),
        ("Mul", "numbers zero", "zeros", {}),
        ("ReduceSum", "zeros columns", "doubt", {}),
        ("Add", f"{values} doubt", "action", {}),
        ("Clip", f"{values} least most", "clipped", {}),
        ("Mul", "clipped span", "offset", {}),
        ("Add", "offset centre", "commanded", {}),
        ("Add", "commanded doubt", "command", {}),
        *([("Add", "remembered doubt", "next_memory", {})] if remembers else []),
    ]


def _constants(policy: Policy) -> dict[str, np.ndarray]:
    """The numbers of the graph by their names in it."""
    numbers: dict[str, Any] = {
        "mean": policy.observation_mean,
        "deviation": policy.observation_std,
    }
    for number, (weight, bias) in enumerate(zip(policy.weights, policy.biases, strict=True), 1):
        numbers |= {f"weights_{number}": weight, f"biases_{number}": bias}
    if policy.gru is not None:
        numbers |= {
            "recurrent_weights": policy.gru.weights,
            "recurrent_biases": policy.gru.biases,
            "memory_weights": policy.gru.recurrent,
            "memory_biases": policy.gru.recurrent_biases,
        }
    numbers |= {
        "zero": 0.0,
        "least": -1.0,
        "most": 1.0,
        "span": policy.interface.span,
        "centre": policy.interface.centre,
    }
    whole = {"columns": [1], **({"thirds": [policy.spec.memory] * 3} if policy.gru else {})}
    return {name: np.asarray(value, np.float32) for name, value in numbers.items()} | {
        name: np.array(value, np.int64) for name, value in whole.items()
    }
