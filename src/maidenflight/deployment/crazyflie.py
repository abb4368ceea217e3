"""A policy as an app for the Crazyflie: an out-of-tree controller that is built beside an
unmodified firmware.

The app's text stands in the folder `crazyflie` beside this module; `policy.h` and `policy.c` come
from `c`. The app feeds what the firmware knows of the drone to the policy, at the policy's rate,
and the policy's commands to the firmware; it guards the flight and hands back to the firmware's PID
(docs/crazyflie.md).

Source: interface, units and signs of the Crazyflie firmware 2026.08 (2a18fc299d7b), described from
reading; no text of it is used.
"""

import hashlib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from maidenflight import __version__, results
from maidenflight.deployment.c import COMMANDS, export_c
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.policy import Policy, to_json
from maidenflight.simulator.battery import COUNTS, MOST_COUNTS

MAIN_LOOP = 1000
"""Steps a second of the firmware's stabilizer (stabilizer_types.h)."""
MOST_MULTIPLICATIONS = 12_000
"""Of a network: half a millisecond of the drone's processor at 7 cycles a multiplication (counted
on an emulated Cortex-M4), which leaves the other half of a stabilizer's step to the firmware."""
WIDEST = 100
"""Numbers in a layer: two layers lie on the stack of the firmware's stabilizer, 1800 bytes, of
which they then take 800."""
_VERBATIM = ("Makefile", "Kbuild", "app-config", "src/Kbuild")


def export_crazyflie(
    policy: Policy,
    directory: StrPath,
    *,
    seed: int = 0,
    record: Mapping[str, Any] | None = None,
    full: float = COUNTS,
) -> list[Path]:
    """Writes a policy as an app: `make CRAZYFLIE_BASE=...` in its folder builds a firmware.

    The same arguments give the same bytes.

    Args:
        policy: the policy.
        directory: where to write; made if missing.
        seed: random seed of the golden vectors of the self-test.
        record: how the policy was made, for a comment.
        full: what u = 1 means to the firmware [counts], a default that the parameter `mf.full`
            overrides.

    Returns:
        The files written.

    Raises:
        InputError: the policy makes no sense, its rate does not divide the firmware's, its network
            is too large for the drone, the counts are not within 0 and 65535, or the directory
            cannot be written.
    """
    if policy.control not in COMMANDS:
        raise InputError(
            f"policy: control = {policy.control!r}; a Crazyflie can be given {', '.join(COMMANDS)}."
        )
    if MAIN_LOOP % policy.rate:
        raise InputError(
            f"policy: rate = {policy.rate} Hz does not divide the {MAIN_LOOP} Hz of the firmware. "
            "Train at 100, 50 or 25 Hz."
        )
    if not 0.0 < full <= MOST_COUNTS:
        raise InputError(f"full = {full}; expected counts above 0 and at most {MOST_COUNTS:g}.")
    multiplications, widest = sum(weight.size for weight in policy.weights), max(policy.layer_sizes)
    if multiplications > MOST_MULTIPLICATIONS or widest > WIDEST:
        raise InputError(
            f"policy: {multiplications} multiplications and layers of up to {widest} numbers; the "
            "drone has time for "
            f"{MOST_MULTIPLICATIONS} and room for {WIDEST}. Train a smaller network, such as 50-50."
        )
    content = {
        "version": __version__,
        "hash": hashlib.sha256(to_json(policy).encode()).hexdigest(),
        "control": policy.control,
        "rate": policy.rate,
        "full": f"{np.float32(full)!s}f",
        "level": COMMANDS[policy.control].level,
        "drive": _text(f"src/{policy.control}.drive"),
    }
    folder = Path(directory)
    code = export_c(policy, folder / "src", seed=seed, record=record, full=full)
    made = {name: _text(name) for name in _VERBATIM}
    made |= {
        name: Template(_text(f"{name}.template")).substitute(content)
        for name in ("src/maidenflight.c", "README.md")
    }
    return [*code, *(results.write(folder / name, text) for name, text in made.items())]


def _text(name: str) -> str:
    return (
        resources.files("maidenflight.deployment")
        .joinpath("crazyflie", *name.split("/"))
        .read_text(encoding="utf-8")
    )
