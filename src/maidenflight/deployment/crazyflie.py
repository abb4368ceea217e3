"""A policy as a Crazyflie app: an out-of-tree controller beside an unmodified firmware.

The app's text is in the folder `crazyflie` beside this module; `policy.h` and `policy.c` come from
`c`. The app passes the firmware's estimates to the policy and the policy's commands to the
firmware, checks limits in flight, and hands back to the firmware's PID (docs/crazyflie.md).

Source: interface, units and signs of the Crazyflie firmware 2026.08 (2a18fc299d7b), described from
reading; no text of it is used.
"""

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from maidenflight import __version__, results
from maidenflight.deployment.c import digest, export_c
from maidenflight.deployment.commands import level_in_c
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.policy import Policy

MAIN_LOOP = 1000
"""Steps a second of the firmware's stabilizer (stabilizer_types.h)."""
MOST_MULTIPLICATIONS = 12_000
"""Of a network: half a millisecond of the drone's processor at 7 cycles a multiplication (counted
on an emulated Cortex-M4), which leaves the other half of a stabilizer's step to the firmware."""
WIDEST = 100
"""Numbers in a layer: two layers lie on the stack of the firmware's stabilizer, 1800 bytes, of
which they then take 800."""
_FOLDER = resources.files("maidenflight.deployment").joinpath("crazyflie")
_VERBATIM = ("Makefile", "Kbuild", "app-config", "src/Kbuild")


def export_crazyflie(
    policy: Policy,
    directory: StrPath,
    *,
    hover: float | None = None,
    seed: int = 0,
    record: Mapping[str, Any] | None = None,
) -> list[Path]:
    """Writes a policy as an app: `make CRAZYFLIE_BASE=...` in its folder builds a firmware.

    The same arguments give the same bytes.

    Args:
        policy: the policy.
        directory: where to write; made if missing.
        hover: see `export_c`; the app itself measures it in flight.
        seed: random seed of the golden vectors of the self-test.
        record: how the policy was made, for a comment.

    Returns:
        The files written.

    Raises:
        InputError: the policy makes no sense, the app cannot drive its control structure, its rate
            does not divide the firmware's, its network is too large for the drone, or the directory
            cannot be written.
    """
    policy.check()
    interface = policy.interface
    if interface.name not in drives():
        raise InputError(
            f"policy: control = {interface.name!r}; a Crazyflie can be given {', '.join(drives())}."
        )
    if MAIN_LOOP % interface.rate:
        raise InputError(
            f"policy: rate = {interface.rate} Hz does not divide the {MAIN_LOOP} Hz of the "
            "firmware. Train at 100, 50 or 25 Hz."
        )
    multiplications, widest = sum(weight.size for weight in policy.weights), max(policy.layer_sizes)
    if multiplications > MOST_MULTIPLICATIONS or widest > WIDEST:
        raise InputError(
            f"policy: {multiplications} multiplications and layers of up to {widest} numbers; the "
            "drone has time for "
            f"{MOST_MULTIPLICATIONS} and room for {WIDEST}. Train a smaller network, such as 50-50."
        )
    content = {
        "version": __version__,
        "hash": digest(policy),
        "control": interface.name,
        "rate": interface.rate,
        "full": f"{np.float32(interface.full_scale_counts)!s}f",
        "level": level_in_c(interface),
        "drive": _text(f"src/{interface.name}.drive"),
    }
    folder = Path(directory)
    code = export_c(policy, folder / "src", hover=hover, seed=seed, record=record)
    made = {name: _text(name) for name in _VERBATIM}
    made |= {
        name: Template(_text(f"{name}.template")).substitute(content)
        for name in ("src/maidenflight.c", "README.md")
    }
    return [*code, *(results.write(folder / name, text) for name, text in made.items())]


def drives() -> list[str]:
    """Names of the interfaces whose commands the app can give to the firmware, each a file."""
    names = [entry.name for entry in _FOLDER.joinpath("src").iterdir()]
    return sorted(name.removesuffix(".drive") for name in names if name.endswith(".drive"))


def _text(name: str) -> str:
    return _FOLDER.joinpath(*name.split("/")).read_text(encoding="utf-8")
