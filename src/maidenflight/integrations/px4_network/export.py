"""The files that PX4's `mc_nn_control` is built of: the network in C++, and parameters.

`control_net.cpp` and `.hpp` replace PX4's own in src/modules/mc_nn_control. The network's outputs
are in PX4's order of motors. The parameters make a thrust of full scale an output of 1: the module
then needs no motor's rpm.

Source: PX4-Autopilot, src/modules/mc_nn_control (control_net.hpp, actions_rescale.hpp,
mc_nn_control_params.yaml).
"""

import math
from pathlib import Path

import numpy as np

from maidenflight import __version__, results
from maidenflight.deployment.commands import check_form
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.integrations.px4_network.form import PX4
from maidenflight.integrations.px4_network.tflite_file import Layer, to_tflite
from maidenflight.integrations.raptor.px4 import CONTROLS
from maidenflight.policy import Policy

COEFFICIENT = 1.2
"""MC_NN_THRST_COEF [1e-5 1/s^2], the firmware's default; the largest rpm follows."""
PARAMETERS = (
    ("MC_NN_THRST_COEF", f"{COEFFICIENT}", 9),
    ("MC_NN_MIN_RPM", "0", 6),
    ("MC_NN_MAX_RPM", f"{round(60.0 * math.sqrt(2.0 / (COEFFICIENT * 1e-5)))}", 6),
)
"""Names, values and types by MAVLink's specification: an output of 1 is the largest rpm."""


def export_px4(policy: Policy, directory: StrPath, *, name: str = "policy") -> list[Path]:
    """Writes a policy of the form `px4` for `mc_nn_control`.

    Args:
        policy: the policy.
        directory: where to write; made if missing.
        name: of the policy, for comments.

    Returns:
        The files written: `control_net.tflite`, `control_net.cpp`, `control_net.hpp` and
        `neural.params`.

    Raises:
        InputError: the policy makes no sense or is of another form; `tflite` is not installed; or
            the directory cannot be written.
    """
    origin = f"{name}, by maidenflight {__version__}"
    model = to_tflite(layers_of(policy), origin)
    lines = [f"1\t1\t{key}\t{value}\t{kind}" for key, value, kind in PARAMETERS]
    heading = f"# {origin}\n# Vehicle-Id\tComponent-Id\tName\tValue\tType\n"
    files = {
        "control_net.tflite": model,
        "control_net.cpp": _source(model, origin),
        "control_net.hpp": _header(len(model), origin),
        "neural.params": heading + "\n".join(lines) + "\n",
    }
    return [results.write(Path(directory) / path, content) for path, content in files.items()]


def layers_of(policy: Policy) -> list[Layer]:
    """Returns the network's layers: inputs as PX4 has them, and outputs in its order of motors.

    Raises:
        InputError: the policy makes no sense or is of another form, or a weight is too large.
    """
    policy.check()
    if policy.spec.form != PX4:
        check_form(policy)
        raise InputError(
            f"policy: of the form {policy.spec.form}; PX4's mc_nn_control flies policies of its "
            "own form only. Train one: maidenflight train --form px4."
        )
    mean, deviation = (
        np.asarray(array, np.float64) for array in (policy.observation_mean, policy.observation_std)
    )
    tables = zip(policy.weights, policy.biases, strict=True)
    layers = [tuple(np.asarray(table, np.float64) for table in pair) for pair in tables]
    weights, biases = layers[0]
    scaled = weights / deviation
    layers[0] = scaled, biases - scaled @ mean
    order = list(CONTROLS)
    layers[-1] = layers[-1][0][order], layers[-1][1][order]
    largest = max(np.abs(table).max() for pair in layers for table in pair)
    if largest > np.finfo(np.float32).max:
        raise InputError("policy: a weight overflows float32. Training diverged: train again.")
    return [(weights.astype(np.float32), other.astype(np.float32)) for weights, other in layers]


def _source(model: bytes, origin: str) -> str:
    rows = [
        "\t" + " ".join(f"0x{byte:02x}," for byte in model[start : start + 12])
        for start in range(0, len(model), 12)
    ]
    head = f'// {origin}\n#include "control_net.hpp"\n\n'
    array = "alignas(16) const unsigned char control_net_tflite[] = {\n"
    return head + array + "\n".join(rows) + "\n};\n"


def _header(size: int, origin: str) -> str:
    return (
        f"// {origin}\n#pragma once\n#include <cstdint>\n\n"
        f"constexpr unsigned int control_net_tflite_size = {size};\n"
        "extern const unsigned char control_net_tflite[];\n"
    )
