"""A policy as C99: two files that need no library, no heap and no operating system.

The C text stands in `policy.h.template` and `policy.c.template`; this module fills in the numbers.
Weights are laid out so that four outputs are computed at once, which was the fastest of the
variants counted on an emulated Cortex-M4 (15 300 instructions for 40-50-50-4, 26 400 row by row).
Before it flies, the drone calls `mf_policy_self_test`, which checks the tables against a checksum
and the arithmetic against golden vectors; those come from float64 sums in NumPy, so that neither
the machine nor the accelerator used here shows in the files.
"""

import hashlib
import json
import textwrap
from collections.abc import Iterable, Mapping
from importlib import resources
from itertools import chain, starmap
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maidenflight import __version__, results
from maidenflight.deployment import look_ahead, memory
from maidenflight.deployment.commands import check_form, check_hover, described, level_in_c
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.policy import Policy
from maidenflight.policy_file import to_json
from maidenflight.simulator.gru import Gru
from maidenflight.simulator.policy_spec import ACTION_SIZE, OBSERVATION_SIZE

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
    hover: float | None = None,
    seed: int = 0,
    record: Mapping[str, Any] | None = None,
    reentrant: bool = True,
) -> list[Path]:
    """Writes a policy as `policy.h` and `policy.c`.

    The same arguments give the same bytes.

    Args:
        policy: the policy, of any control interface.
        directory: where to write; made if missing.
        hover: share of full thrust at which the drone hovers, 1 / thrust_to_weight, for
            `MF_HOVER`; not written by default.
        seed: random seed of the golden vectors.
        record: how the policy was made, for the header's comment.
        reentrant: whether several tasks may compute at the same time, each with two layers on its
            stack; else the layers lie in static memory, and a small stack does for any network.

    Returns:
        The files written: the header and the source.

    Raises:
        InputError: the policy or the share makes no sense, the policy is of RAPTOR's form, or the
            directory cannot be written.
    """
    policy.check()
    check_form(policy)
    check_hover(hover)
    if beyond := policy.spec.beyond("history", "look_ahead", "memory", "hidden"):
        raise InputError(f"policy: {beyond}, which the templates of the C code do not know.")
    interface = policy.interface
    layers = [_in_fours(*layer) for layer in zip(policy.weights, policy.biases, strict=True)]
    observations = golden_observations(policy, seed)
    actions = _evaluated(policy, observations)
    tolerance = np.float32(TOLERANCE * max(1.0, float(np.abs(actions).max())))
    tables = _tables(policy, layers, observations, actions)
    scales = [tables[name] for name in _SCALES]
    widest = max(max(weights.shape[1], len(biases)) for weights, biases in layers)
    gates = 0 if policy.gru is None else 8 * len(policy.gru.biases)
    storage, shared = "", ""
    if not reentrant:
        storage, shared = "static ", " /* not on the stack: one task at a time */"
    content = {
        **look_ahead.in_policy(policy.spec),
        **memory.in_policy(policy.gru, storage, shared),
        "version": __version__,
        "hash": digest(policy),
        "record": _comment(record),
        "control": interface.name,
        "commands": _wrapped(f"Commands: {described(interface)}"),
        "level": level_in_c(interface),
        "share": "1.0f / thrust_to_weight" if hover is None else "MF_HOVER",
        "hover": "" if hover is None else _hover(hover),
        "drive": "drive_motors" if interface.name == "pwm" else "follow",
        "rate": interface.rate,
        "history": policy.spec.history,
        "layer_sizes": "-".join(str(size) for size in policy.layer_sizes),
        "multiplications": policy.multiplications,
        "constants": sum(numbers.nbytes for numbers in tables.values()) + 16 * len(layers),
        "state": 4 * (policy.spec.size + ACTION_SIZE + 1),
        "storage": storage,
        "shared": shared,
        "tasks": "several tasks may compute at a time" if reentrant else "one task at a time",
        "variables": 0 if reentrant else 8 * widest + gates,
        "stack": 250 + 4 * policy.spec.memory + (8 * widest + gates if reentrant else 0),
        "instant_size": OBSERVATION_SIZE,
        "action_size": ACTION_SIZE,
        "layer_count": len(layers),
        "widest": widest,
        "golden_count": GOLDEN_COUNT,
        "tolerance": _literal(tolerance),
        "checksum": checksum(chain(scales, *layers, *_recurrent(policy.gru))),
        "tables": "\n\n".join([*starmap(_array, tables.items()), _layer_table(layers)]),
    }
    return [
        results.write(Path(directory) / name, _template(name).substitute(content))
        for name in ("policy.h", "policy.c")
    ]


def golden_observations(policy: Policy, seed: int) -> Numbers:
    """Returns random observations such as policy meets in flight, (GOLDEN_COUNT, 20 H + 3 K + M).

    Each number lies within two deviations of its mean in the policy's own normaliser, the instants
    of one observation differ little, and quaternions have length 1.
    """
    random = np.random.default_rng(seed)
    shape = (GOLDEN_COUNT, policy.spec.history, OBSERVATION_SIZE)
    deviation = random.uniform(-1.8, 1.8, (GOLDEN_COUNT, 1, OBSERVATION_SIZE))
    deviation = deviation + random.uniform(-0.2, 0.2, shape)
    middle, spread = _normalizer(policy)
    size = OBSERVATION_SIZE * policy.spec.history
    instants = middle[:size].reshape(shape[1:]) + spread[:size].reshape(shape[1:]) * deviation
    instants[..., _QUATERNION] /= np.linalg.norm(instants[..., _QUATERNION], axis=-1, keepdims=True)
    flat = instants.reshape(GOLDEN_COUNT, -1)
    deviation = random.uniform(-2.0, 2.0, (GOLDEN_COUNT, len(middle) - size))
    ahead = middle[size:] + spread[size:] * deviation
    remembered = random.uniform(-1.0, 1.0, (GOLDEN_COUNT, policy.spec.memory))
    return np.concatenate([flat, ahead, remembered], axis=1).astype(np.float32)


def digest(policy: Policy) -> str:
    """Returns the SHA-256 of a policy's JSON text without its record."""
    return hashlib.sha256(to_json(policy).encode()).hexdigest()


def checksum(tables: Iterable[Numbers]) -> int:
    """Computes 32-bit FNV-1a over float32 bit patterns, one 32-bit word at a time instead of bytes.

    Source: Fowler, Noll, Vo (RFC 9923), offset basis and prime for 32 bits.
    """
    total = 2166136261
    for table in tables:
        for pattern in np.ascontiguousarray(table, np.float32).reshape(-1).view(np.uint32).tolist():
            total = (total ^ pattern) * 16777619 & 0xFFFFFFFF
    return total


def _normalizer(policy: Policy) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and deviation of the observations."""
    mean, deviation = policy.observation_mean, policy.observation_std
    return np.asarray(mean, np.float64), np.asarray(deviation, np.float64)


def _evaluated(policy: Policy, observations: Numbers) -> Numbers:
    """The policy's outputs for a batch of observations, summed in float64 and then rounded."""
    mean, deviation = _normalizer(policy)
    observed, memory = np.split(np.asarray(observations, np.float64), [len(mean)], axis=1)
    values = (observed - mean) / deviation
    for number, (weight, bias) in enumerate(zip(policy.weights, policy.biases, strict=True)):
        values = np.maximum(values, 0.0) if number > 0 else values
        if number == 1 and policy.gru is not None:
            memory = remembered(policy.gru, values, memory)
            values = np.concatenate([values, memory], axis=1)
        values = values @ np.asarray(weight, np.float64).T + np.asarray(bias, np.float64)
    values = np.concatenate([values, memory], axis=1)
    if not np.all(np.abs(values) < np.finfo(np.float32).max):
        raise InputError(
            f"policy: an action of size {np.abs(values).max():.1e} overflows float32. Training "
            "diverged: train again."
        )
    return values.astype(np.float32)


def remembered(gru: Gru, values: NDArray[Any], memory: NDArray[Any]) -> NDArray[Any]:
    """Returns what a recurrent unit remembers next, of a batch, in float64.

    Args:
        gru: the unit.
        values: its inputs, (B, I).
        memory: before, (B, M).
    """

    def gates(weights: Any, inputs: NDArray[Any], biases: Any) -> list[NDArray[Any]]:
        sums = inputs @ np.asarray(weights, np.float64).T + np.asarray(biases, np.float64)
        return np.split(sums, 3, axis=1)

    gate_inputs = gates(gru.weights, values, gru.biases)
    recurrent_gates = gates(gru.recurrent, memory, gru.recurrent_biases)
    reset, update = (
        0.5 + 0.5 * np.tanh((gate_inputs[row] + recurrent_gates[row]) / 2.0) for row in (0, 1)
    )
    candidate = np.tanh(gate_inputs[2] + reset * recurrent_gates[2])
    return (1.0 - update) * candidate + update * memory


def _recurrent(gru: Gru | None) -> Layers:
    """Of a recurrent unit: what it makes of values, and what of its memory."""
    if gru is None:
        return []
    return [_in_fours(gru.weights, gru.biases), _in_fours(gru.recurrent, gru.recurrent_biases)]


def _in_fours(weight: Any, bias: Any) -> tuple[Numbers, Numbers]:
    """Weights as (rows / 4, inputs, 4) and biases, with rows of zeros up to a multiple of four."""
    rows = np.asarray(weight, np.float32)
    missing = -len(rows) % _ROWS
    rows = np.pad(rows, ((0, missing), (0, 0)))
    together = np.ascontiguousarray(rows.reshape(-1, _ROWS, rows.shape[1]).transpose(0, 2, 1))
    return together, np.pad(np.asarray(bias, np.float32), (0, missing))


def _tables(
    policy: Policy, layers: Layers, observations: Numbers, actions: Numbers
) -> dict[str, Numbers]:
    """Every table of the source by its name in C."""
    interface = policy.interface
    scales = (policy.observation_mean, policy.observation_std, interface.centre, interface.span)
    tables = {
        name: np.asarray(numbers, np.float32) for name, numbers in zip(_SCALES, scales, strict=True)
    }
    for number, (weights, biases) in enumerate(layers, 1):
        tables |= {f"weights_{number}": weights.reshape(-1), f"biases_{number}": biases}
    for number, (weights, biases) in enumerate(_recurrent(policy.gru), 1):
        tables |= {
            f"recurrent_weights_{number}": weights.reshape(-1),
            f"recurrent_biases_{number}": biases,
        }
    return tables | {"golden_observations": observations, "golden_actions": actions}


def _literal(number: np.float32) -> str:
    """The shortest C literal that reads back to the same float32."""
    return f"{number!s}f"


def _hover(share: float) -> str:
    comment = "share of full thrust at which the drone that it was trained for hovers"
    return f"#define MF_HOVER {_literal(np.float32(share))} /* {comment} */\n"


def _array(name: str, numbers: Numbers) -> str:
    rows = [", ".join(_literal(number) for number in row) for row in np.atleast_2d(numbers)]
    blocks = rows if numbers.ndim == 1 else [f"{{{row}}}," for row in rows]
    lines = "\n".join(
        textwrap.fill(block, _WIDTH, initial_indent="    ", subsequent_indent="    ")
        for block in blocks
    )
    sizes = "".join(f"[{size}]" for size in numbers.shape)
    return f"static const float {name}{sizes} = {{\n{lines}\n}};"


def _layer_table(layers: Layers) -> str:
    """The table in C that says which weights follow which."""
    lines = [
        f"    {{weights_{number}, biases_{number}, {weights.shape[1]}, {len(biases)}}},"
        for number, (weights, biases) in enumerate(layers, 1)
    ]
    return "\n".join(["static const layer layers[LAYER_COUNT] = {", *lines, "};"])


def _wrapped(text: str) -> str:
    """Text as lines of a C comment."""
    return textwrap.fill(
        text,
        _WIDTH - 4,
        initial_indent=" * ",
        subsequent_indent=" * ",
        break_on_hyphens=False,
    )


def _comment(record: Mapping[str, Any] | None) -> str:
    """A record as a C comment; what would end it is escaped as JSON allows."""
    text = json.dumps(dict(record or {})).replace("*", "\\u002a").replace("?", "\\u003f")
    lines = textwrap.wrap(text, _WIDTH - 13, break_on_hyphens=False)
    return " * Record:   " + "\n *           ".join(lines)


def _template(name: str) -> Template:
    folder = resources.files("maidenflight.deployment")
    return Template(folder.joinpath(f"{name}.template").read_text(encoding="utf-8"))
