"""A policy of RAPTOR's form for PX4: the archive that its module loads, and commands to compare.

`mc_raptor` reads `raptor/policy.tar` of the SD card, a ustar archive: each table is a file `data`
of float32 beside a file `meta` of lines, and the first five instants of the example are computed
anew when it starts. Its inputs are NED and FRD, turned into our axes. Every table is a tensor, as
RL-tools has read them since 2025-11-09: weights have two dimensions and biases one, where the HDF5
for `foundation-policy` keeps matrices.

| policy | PX4 |
|---|---|
| output a in [-1, 1] | `actuator_motors.control` = (a + 1) / 2, from 0, idle, to 1, full |
| outputs 0 to 3: front right, back right, back left, front left | controls 0, 3, 1, 2 |
| output below -1 | a negative control, by which PX4 disarms that motor; above 1 it is cut off |

Source: PX4-Autopilot, src/modules/mc_raptor (30bf3d03ef79) and src/lib/mixer_module/functions;
RL-tools, persist/backends/tar (46dd9e5e091e) and nn/layers/dense, described from reading.
"""

import io
import tarfile
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from maidenflight.errors import InputError
from maidenflight.integrations.raptor.checkpoint import (
    META,
    Numbers,
    example,
    layers_of,
    network_of,
)
from maidenflight.policy import Policy

NAME = "policy.tar"
BENCH = "commands.csv"
CONTROLS = (0, 2, 3, 1)
"""Outputs by control of PX4's Quadrotor X."""
LONGEST_META = 255
"""Characters that the firmware's module reads of `actor/meta`; of a table's it reads 99."""
STATES: dict[str, tuple[list[float], list[float], list[float], list[float]]] = {
    "at the set-point": ([0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0]),
    "0.3 m below": ([0, 0, -0.3], [0, 0, 0], [0, 0, 0], [0, 0, 0]),
    "0.3 m ahead": ([0.3, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0]),
    "0.3 m to the left": ([0, 0.3, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0]),
    "right side down by 10 deg": ([0, 0, 0], [10, 0, 0], [0, 0, 0], [0, 0, 0]),
    "nose down by 10 deg": ([0, 0, 0], [0, 10, 0], [0, 0, 0], [0, 0, 0]),
    "turned left by 10 deg": ([0, 0, 0], [0, 0, 10], [0, 0, 0], [0, 0, 0]),
    "sinking by 0.5 m/s": ([0, 0, 0], [0, 0, 0], [0, 0, -0.5], [0, 0, 0]),
    "rolling right by 1 rad/s": ([0, 0, 0], [0, 0, 0], [0, 0, 0], [1, 0, 0]),
}
"""Position less set-point [m], roll, pitch and yaw [deg], velocity [m/s] and body rates [rad/s]; in
our axes: x forward, y left, z up."""


def to_archive(policy: Policy, name: str = "policy", seed: int = 0) -> bytes:
    """Returns the bytes of `policy.tar`. The same arguments give the same bytes.

    Args:
        policy: a policy of RAPTOR's form.
        name: which the checkpoint bears.
        seed: random seed of the example.

    Raises:
        InputError: see `example`; or the name is too long for the module.
    """
    meta = f"type: sequential\ncheckpoint_name: {name}\nmeta: {META}\n"
    if len(meta.encode()) > LONGEST_META or "\n" in name:
        raise InputError(f"{name}: too long a name for PX4. Rename the file, as to policy_1.json.")
    content = io.BytesIO()
    with tarfile.open(fileobj=content, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for path, data in [("actor/meta", meta.encode()), *_tables(policy, seed)]:
            entry = tarfile.TarInfo(path)
            entry.size = len(data)
            archive.addfile(entry, io.BytesIO(data))
    return content.getvalue()


def _tables(policy: Policy, seed: int) -> Iterator[tuple[str, bytes]]:
    """Paths and contents of layers and example."""
    for number, (kind, activation, tables) in enumerate(layers_of(policy)):
        group = f"actor/layers/{number}"
        header = f"activation_function: {activation}\n" if activation else ""
        yield f"{group}/meta", f"{header}type: {kind}\n".encode()
        for parameter, numbers in tables.items():
            is_row = kind == "dense" and parameter == "biases"
            table = numbers[0] if is_row else numbers
            yield from _table(f"{group}/{parameter}/parameters", table)
    for what, numbers in zip(("input", "output"), example(policy, seed), strict=True):
        yield from _table(f"example/{what}", numbers)


def _table(path: str, numbers: Numbers) -> Iterator[tuple[str, bytes]]:
    """A tensor: its type and sizes, and its numbers, little endian."""
    sizes = [f"dim_{axis}: {size}" for axis, size in enumerate(numbers.shape)]
    lines = ["type: tensor", "dtype: float32", f"num_dims: {numbers.ndim}", *sizes]
    yield f"{path}/meta", ("\n".join(lines) + "\n").encode()
    yield f"{path}/data", np.ascontiguousarray(numbers, "<f4").tobytes()


def controls_of(output: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns PX4's motor controls of an output, (..., 4), by the module's mapping."""
    return (output[..., CONTROLS] + 1.0) / 2.0


def commands(policy: Policy) -> str:
    """Returns a table of first commands at `STATES`, to compare on the bench without propellers.

    Just activated, memory and last action are zero. Controls outside [0, 1] are those of the table
    above.
    """
    respond, nothing = network_of(policy), np.zeros((1, policy.spec.memory))
    lines = ["state,control_0,control_1,control_2,control_3"]
    for state, (error, angles, velocity, rates) in STATES.items():
        turned = Rotation.from_euler("ZYX", angles[::-1], degrees=True).as_matrix().ravel()
        inputs = np.concatenate([error, turned, velocity, rates, np.zeros(4)])
        controls = controls_of(respond(inputs[None], nothing)[0][0])
        lines.append(f"{state}," + ",".join(f"{control:.4f}" for control in controls))
    return "\n".join(lines) + "\n"
