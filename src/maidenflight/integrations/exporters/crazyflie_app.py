"""A policy as a Crazyflie app: an out-of-tree controller beside an unmodified firmware.

The app's text is in the folder `crazyflie` beside this module; `policy.h` and `policy.c` come from
`c`. The app passes the firmware's estimates to the policy and the policy's commands to the
firmware, checks limits in flight, and hands back to the firmware's PID (docs/real-drones.md).

Source: interface, units and signs of the Crazyflie firmware 2026.08 (2a18fc299d7b), described from
reading; no text of it is used.
"""

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from maidenflight import __version__, names, results
from maidenflight.deployment.c import digest, export_c
from maidenflight.deployment.commands import level_in_c
from maidenflight.deployment.look_ahead import in_app
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.policy import Policy

MAIN_LOOP = 1000
"""Steps a second of the firmware's stabilizer (stabilizer_types.h)."""
MOST_MULTIPLICATIONS = 12_000
"""Of a network: half a millisecond of the drone's processor at 7 cycles a multiplication (counted
on an emulated Cortex-M4), which leaves the other half of a stabilizer's step to the firmware."""
_LEGACY = "CONFIG_CRAZYFLIE_LEGACY_PROPELLERS=y\n"
_UPGRADE = "CONFIG_CRAZYFLIE_THRUST_UPGRADE_KIT=y\n"
PROPELLERS = dict(zip(names.PROPELLERS, ("", _LEGACY, _UPGRADE), strict=True))
"""What the firmware's configuration says of the drone's propellers, on which its battery
compensation depends; nothing for those that it assumes (firmware 2026.08, Kconfig)."""
_FOLDER = resources.files("maidenflight.integrations.exporters").joinpath("crazyflie")
_VERBATIM = ("Makefile", "Kbuild", "app-config", "src/Kbuild")


def export_crazyflie(
    policy: Policy,
    directory: StrPath,
    *,
    hover: float | None = None,
    seed: int = 0,
    record: Mapping[str, Any] | None = None,
    propellers: str = "2.1+",
) -> list[Path]:
    """Writes a policy as an app: `make CRAZYFLIE_BASE=...` in its folder builds a firmware.

    The same arguments give the same bytes.

    Args:
        policy: the policy.
        directory: where to write; made if missing.
        hover: see `export_c`; the app itself measures it in flight.
        seed: random seed of the golden vectors of the self-test.
        record: how the policy was made, for a comment.
        propellers: those of the drone, a name in `PROPELLERS`.

    Returns:
        The files written.

    Raises:
        InputError: the policy makes no sense, the app cannot drive its control structure, its rate
            does not divide the firmware's, its network is too large for the drone, no propellers
            have that name, or the directory cannot be written.
    """
    policy.check()
    interface = policy.interface
    if interface.name not in drives():
        raise InputError(
            f"policy: control = {interface.name!r}; a Crazyflie takes {', '.join(drives())}."
        )
    if MAIN_LOOP % interface.rate:
        raise InputError(
            f"policy: rate = {interface.rate} Hz does not divide the {MAIN_LOOP} Hz of the "
            "firmware. Train at 100, 50 or 25 Hz."
        )
    if policy.multiplications > MOST_MULTIPLICATIONS:
        raise InputError(
            f"policy: {policy.multiplications} multiplications; the drone has time for "
            f"{MOST_MULTIPLICATIONS}. Train a smaller network: maidenflight train --hidden 50,50."
        )
    if propellers not in PROPELLERS:
        raise InputError(f"propellers = {propellers!r}; expected {', '.join(PROPELLERS)}.")
    drive = _text(f"src/{interface.name}.drive")
    content = {
        **in_app(policy.spec),
        "version": __version__,
        "hash": digest(policy),
        "code": digest(policy)[:8],
        "propeller_number": list(PROPELLERS).index(propellers),
        "control": interface.name,
        "rate": interface.rate,
        "full": f"{np.float32(interface.full_scale_counts)!s}f",
        "level": level_in_c(interface),
        "drive": drive,
        "firmware": "2025.12" if "normalizedForces" in drive else "2023.11",
        "propellers": propellers,
    }
    folder = Path(directory)
    # The self-test runs on the small stack of the firmware's start-up, so layers stay off it.
    code = export_c(policy, folder / "src", hover=hover, seed=seed, record=record, reentrant=False)
    files = {name: _text(name) for name in _VERBATIM}
    files["app-config"] += PROPELLERS[propellers]
    files |= {
        name: Template(_text(f"{name}.template")).substitute(content)
        for name in ("src/maidenflight.c", "README.md")
    }
    return [*code, *(results.write(folder / name, text) for name, text in files.items())]


def drives() -> list[str]:
    """Lists the interfaces whose commands the app can give to the firmware, each a file."""
    names = [entry.name for entry in _FOLDER.joinpath("src").iterdir()]
    return sorted(name.removesuffix(".drive") for name in names if name.endswith(".drive"))


def _text(name: str) -> str:
    return _FOLDER.joinpath(*name.split("/")).read_text(encoding="utf-8")
