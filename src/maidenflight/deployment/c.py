"""A policy as C99: two files that need no library, no heap and no operating system.

The C text stands in `policy.h.template` and `policy.c.template`; this module fills in the numbers.
Weights are laid out so that four outputs are computed at once, which was the fastest of the
variants counted on an emulated Cortex-M4 (15 300 instructions for 40-50-50-4, 26 400 row by row).
Before it flies, the drone checks the tables against a checksum and the arithmetic against golden
vectors; those come from float64 sums in NumPy, so that neither the machine nor the accelerator used
here shows in the files.
"""

import hashlib
import json
import math
import textwrap
from collections.abc import Iterable, Mapping
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from maidenflight import __version__, results
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.policy import Policy, from_json, to_json
from maidenflight.simulator.battery import COUNTS
from maidenflight.simulator.environment import ACTION_SIZE, OBSERVATION_SIZE


class Commands(NamedTuple):
    """What the actions of a control structure mean: command = centre + span clip(a, -1, 1)."""

    centre: tuple[float, float, float, float]
    span: tuple[float, float, float, float]
    told: str
    """In the header."""
    level: str
    """The action that keeps a drone level, in C."""


_MOTORS = """
Motors: 1 front right, 2 back right, 3 back left, 4 front left; 1 and 3 turn counter-clockwise, seen from above. A command u is the
wanted share in [0, 1] of a motor's full thrust; u = 1 is $full of the firmware's 65535 counts before battery compensation. An action a
gives u = (clip(a, -1, 1) + 1) / 2."""
_THRUST = """collective thrust as a share of the motors' full thrust, 1 for $full of the firmware's 65535 counts, and"""
_FIRMWARE = """The firmware's PIDs follow them. Its commander takes degrees, and its pitch has the other sign: give it -command[2] 180 / pi."""
_ROLL, _LEAN = math.radians(60.0), math.radians(10.0)

COMMANDS = {
    "pwm": Commands(
        (0.5, 0.5, 0.5, 0.5), (0.5, 0.5, 0.5, 0.5), _MOTORS, "{hover, hover, hover, hover}"
    ),
    "attitude_rate": Commands(
        (0.5, 0.0, 0.0, 0.0),
        (0.5, _ROLL, _ROLL, _ROLL),
        f"""
Commands: {_THRUST} roll, pitch and yaw rate [rad/s], body, at most 60 deg/s. {_FIRMWARE}""",
        "{hover, 0.0f, 0.0f, 0.0f}",
    ),
    "attitude": Commands(
        (0.75, 0.0, 0.0, 0.0),
        (1.0 / 6.0, _LEAN, _LEAN, _LEAN),
        f"""
Commands: {_THRUST} roll, pitch and yaw [rad], at most 10 deg. {_FIRMWARE}""",
        "{3.0f * hover - 1.5f, 0.0f, 0.0f, 0.0f}",
    ),
}
"""By control structure; scales as in `simulator.control`."""
GOLDEN_COUNT = 4
"""Observations that the self test recomputes."""
TOLERANCE = 1e-4
"""How far the self test lets an action be off, relative to the largest golden action or 1: some
hundred roundings of float32."""

_ROWS = 4
_WIDTH = 136
_QUATERNION = slice(3, 7)
_SCALES = ("mean", "deviation", "centre", "span")
"""Tables of the observation's and the command's scaling."""

Numbers = NDArray[np.float32]
Layers = list[tuple[Numbers, Numbers]]


def export_c(
    policy: Policy,
    directory: StrPath,
    *,
    seed: int = 0,
    record: Mapping[str, Any] | None = None,
    full: float = COUNTS,
) -> list[Path]:
    """Writes a policy as `policy.h` and `policy.c`.

    The same policy, seed and record give the same bytes.

    Args:
        policy: the policy; its control structure must be one of `COMMANDS`.
        directory: where to write; made if missing.
        seed: random seed of the golden vectors.
        record: how the policy was made, for the header's comment.
        full: counts of a Crazyflie's firmware that u = 1 stands for, for the header's comment.

    Returns:
        The files written: the header and the source.

    Raises:
        InputError: the policy cannot be written in C, makes no sense or the directory cannot be
            written.
    """
    text = _checked_text(policy)
    layers = _padded(policy)
    observations = golden_observations(policy, seed)
    actions = _evaluated(policy, observations)
    tolerance = np.float32(TOLERANCE * max(1.0, float(np.abs(actions).max())))
    tables = _tables(policy, layers, observations, actions)
    commands = COMMANDS[policy.control]
    widest = max([policy.layer_sizes[0], *(len(biases) for _, biases in layers)])
    content = {
        "version": __version__,
        "hash": hashlib.sha256(text.encode()).hexdigest(),
        "record": _comment(record),
        "control": policy.control,
        "commands": _wrapped(commands.told.replace("$full", f"{full:g}")),
        "level": commands.level,
        "drive": "drive_motors" if policy.control == "pwm" else "follow",
        "rate": policy.rate,
        "history": policy.history,
        "layer_sizes": "-".join(str(size) for size in policy.layer_sizes),
        "multiplications": sum(weight.size for weight in policy.weights),
        "constants": sum(numbers.nbytes for numbers in tables.values()) + 16 * len(layers),
        "state": 4 * (policy.layer_sizes[0] + ACTION_SIZE + 1),
        "stack": 8 * widest + 250,
        "instant_size": OBSERVATION_SIZE,
        "action_size": ACTION_SIZE,
        "layer_count": len(layers),
        "widest": widest,
        "golden_count": GOLDEN_COUNT,
        "tolerance": _literal(tolerance),
        "checksum": checksum(
            [
                *(tables[name] for name in _SCALES),
                *(numbers for layer in layers for numbers in layer),
            ]
        ),
        "tables": "\n\n".join(
            [
                *(_array(name, numbers) for name, numbers in tables.items()),
                _layer_table(policy, layers),
            ]
        ),
    }
    return [
        results.write(Path(directory) / name, _template(name).substitute(content))
        for name in ("policy.h", "policy.c")
    ]


def golden_observations(policy: Policy, seed: int) -> Numbers:
    """Random observations such as the policy meets in flight, (GOLDEN_COUNT, 20 H).

    Each number lies within two deviations of its mean in the policy's own normaliser, the instants
    of one observation differ little, and quaternions have length 1.

    Args:
        policy: the policy.
        seed: random seed.
    """
    random = np.random.default_rng(seed)
    shape = (GOLDEN_COUNT, policy.history, OBSERVATION_SIZE)
    place = random.uniform(-1.8, 1.8, (GOLDEN_COUNT, 1, OBSERVATION_SIZE)) + random.uniform(
        -0.2, 0.2, shape
    )
    mean, deviation = (
        np.asarray(numbers, np.float64).reshape(shape[1:])
        for numbers in (policy.observation_mean, policy.observation_std)
    )
    instants = mean + deviation * place
    instants[..., _QUATERNION] /= np.linalg.norm(instants[..., _QUATERNION], axis=-1, keepdims=True)
    return instants.reshape(GOLDEN_COUNT, -1).astype(np.float32)


def checksum(tables: Iterable[Numbers]) -> int:
    """32-bit FNV-1a over the bit patterns of float32 numbers, taken as whole numbers instead of
    bytes.

    Source: Fowler, Noll, Vo (RFC 9923), offset basis and prime for 32 bits.
    """
    total = 2166136261
    for table in tables:
        for pattern in np.ascontiguousarray(table, np.float32).reshape(-1).view(np.uint32).tolist():
            total = (total ^ pattern) * 16777619 & 0xFFFFFFFF
    return total


def _checked_text(policy: Policy) -> str:
    """The policy's JSON text, once it is sure that the policy is sound."""
    if policy.control not in COMMANDS:
        known = " or ".join(repr(name) for name in COMMANDS)
        raise InputError(
            f"policy: control = {policy.control!r}, but C can be written only for {known}. Train "
            f"with control {known}."
        )
    text = to_json(policy)
    from_json(text)
    return text


def _evaluated(policy: Policy, observations: Numbers) -> Numbers:
    """The policy's actions for a batch of observations, summed in float64 and then rounded.

    Raises:
        InputError: an action is too large for float32.
    """
    mean, deviation = (
        np.asarray(numbers, np.float64)
        for numbers in (policy.observation_mean, policy.observation_std)
    )
    values = (observations - mean) / deviation
    for number, (weight, bias) in enumerate(zip(policy.weights, policy.biases, strict=True)):
        values = np.maximum(values, 0.0) if number > 0 else values
        values = values @ np.asarray(weight, np.float64).T + np.asarray(bias, np.float64)
    if not np.all(np.abs(values) < np.finfo(np.float32).max):
        raise InputError(
            f"policy: an action of size {np.abs(values).max():.1e} overflows float32. Training "
            "diverged: train again."
        )
    return values.astype(np.float32)


def _padded(policy: Policy) -> Layers:
    """Weights as (rows / 4, inputs, 4) and biases, with rows of zeros up to a multiple of four."""
    layers = []
    for weight, bias in zip(policy.weights, policy.biases, strict=True):
        rows = np.asarray(weight, np.float32)
        missing = -len(rows) % _ROWS
        rows = np.pad(rows, ((0, missing), (0, 0)))
        together = np.ascontiguousarray(rows.reshape(-1, _ROWS, rows.shape[1]).transpose(0, 2, 1))
        layers.append((together, np.pad(np.asarray(bias, np.float32), (0, missing))))
    return layers


def _tables(
    policy: Policy, layers: Layers, observations: Numbers, actions: Numbers
) -> dict[str, Numbers]:
    """Every table of the source by its name in C."""
    commands = COMMANDS[policy.control]
    scales = (policy.observation_mean, policy.observation_std, commands.centre, commands.span)
    tables = {
        name: np.asarray(numbers, np.float32) for name, numbers in zip(_SCALES, scales, strict=True)
    }
    for number, (weights, biases) in enumerate(layers, 1):
        tables |= {f"weights_{number}": weights.reshape(-1), f"biases_{number}": biases}
    return tables | {"golden_observations": observations, "golden_actions": actions}


def _literal(number: np.float32) -> str:
    """The shortest C literal that reads back to the same float32."""
    return f"{number!s}f"


def _array(name: str, numbers: Numbers) -> str:
    """A constant table in C."""
    rows = [", ".join(_literal(number) for number in row) for row in np.atleast_2d(numbers)]
    blocks = rows if numbers.ndim == 1 else [f"{{{row}}}," for row in rows]
    lines = "\n".join(
        textwrap.fill(block, _WIDTH, initial_indent="    ", subsequent_indent="    ")
        for block in blocks
    )
    sizes = "".join(f"[{size}]" for size in numbers.shape)
    return f"static const float {name}{sizes} = {{\n{lines}\n}};"


def _layer_table(policy: Policy, layers: Layers) -> str:
    """The table in C that says which weights follow which."""
    lines = [
        f"    {{weights_{number}, biases_{number}, {inputs}, {len(biases)}}},"
        for number, (inputs, (_, biases)) in enumerate(
            zip(policy.layer_sizes, layers, strict=False), 1
        )
    ]
    return "\n".join(["static const layer layers[LAYER_COUNT] = {", *lines, "};"])


def _wrapped(told: str) -> str:
    """Text as lines of a C comment."""
    return "\n".join(
        textwrap.wrap(
            told.strip(),
            _WIDTH - 4,
            initial_indent=" * ",
            subsequent_indent=" * ",
            break_on_hyphens=False,
        )
    )


def _comment(record: Mapping[str, Any] | None) -> str:
    """A record as lines of a C comment.

    What would end the comment, or form a trigraph, is escaped as JSON allows.
    """
    text = json.dumps(dict(record or {})).replace("*", "\\u002a").replace("?", "\\u003f")
    lines = textwrap.wrap(text, _WIDTH - 13, break_on_hyphens=False)
    return " * Record:   " + "\n *           ".join(lines)


def _template(name: str) -> Template:
    return Template(
        resources.files("maidenflight.deployment")
        .joinpath(f"{name}.template")
        .read_text(encoding="utf-8")
    )
