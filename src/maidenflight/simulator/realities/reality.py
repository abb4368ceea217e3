"""What policies fly in: the `Reality` protocol, and `reality` by name.

A reality is a `VirtualDrone`, of which many fly at once in JAX, or anything that follows the
`Reality` protocol: another simulator or a test bench, which takes one command at a time.
"""

import dataclasses
import os
from difflib import get_close_matches
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from maidenflight import parameters
from maidenflight.errors import InputError
from maidenflight.registry import REALITIES, import_part
from maidenflight.settings import is_code
from maidenflight.simulator.physics.battery import law_for
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.realities import additions
from maidenflight.simulator.realities.virtual_drone import VARIANTS, VirtualDrone, virtual_drone

MOTORS = "pwm"
"""`Reality.takes` of one that takes thrust commands of the four motors, u in [0, 1]."""
POSITION = "position"
"""`Reality.takes` of one that flies its own position controller: x, y, z [m] and yaw [rad]."""


class Truth(NamedTuple):
    """The state by which a flight is judged, and the motor commands for its log."""

    position: Float[np.ndarray, "3"]
    """World [m]."""
    quaternion: Float[np.ndarray, "4"]
    """Attitude, body to world (x, y, z, w)."""
    body_rates: Float[np.ndarray, "3"]
    """[rad/s]."""
    command: Float[np.ndarray, "4"]
    """Thrust commands u of the motors now, in [0, 1]; NaN where unknown."""


@runtime_checkable
class Reality(Protocol):
    """A drone that takes one command at a time; it keeps its own state and needs no JAX.

    Arrays may be of NumPy or lists; axes, units and motors are those of `dynamics.State`.
    """

    @property
    def name(self) -> str:
        """What tables and logs call it."""
        ...

    @property
    def rate(self) -> int:
        """Calls of `step` a second [Hz].

        A multiple of the controller's rate: 100 for PWM policies, 500 where the firmware's PIDs
        command the motors.
        """
        ...

    @property
    def hover(self) -> float:
        """Thrust command u of each motor at which it hovers, in (0, 1]."""
        ...

    @property
    def takes(self) -> str:
        """What `step` takes.

        `MOTORS`, `POSITION`, or the name of a control structure whose commands it follows by its
        own controller, such as `"attitude_rate"`: thrust u, then roll, pitch and yaw rate [rad/s].
        """
        ...

    def reset(self, position: Float[np.ndarray, "3"], seed: int) -> None:
        """Begins a flight: hover, level and at rest, at a position [m]; the seed is for noise."""
        ...

    def step(self, command: Float[np.ndarray, "4"]) -> None:
        """Holds a command for a period of 1 / `rate`."""
        ...

    def observe(self) -> Measurement:
        """Returns what the sensors say now."""
        ...

    def truth(self) -> Truth:
        """Returns the true state now."""
        ...


AnyReality = VirtualDrone | Reality


def reality(name: str) -> AnyReality:
    """Returns a reality by name.

    Args:
        name: `NAME:SEED` with one of `VARIANTS`; `NAME:SEED@DRONE`, drawn about a drone's TOML
            file or name; `NAME:SEED` or `NAME:DRONE` with a name of `registry.REALITIES` and a
            seed, or a drone that the simulator has; `MODULE:FACTORY`, a class or function without
            arguments that makes a reality, in a Python module that can be imported or lies in the
            working folder; or a drone's TOML file or name, simulated at 1 kHz like virtual drones.
            Behind any of them `+sensors` and `+10ms` add noise and latency; see `additions` for
            these and others.

    Raises:
        InputError: none of these, or what simulates it is not installed.
    """
    if not is_drone(name):
        plain, added = additions.split(name)
        if added:
            return additions.with_additions(reality(plain), added)
    drawn_name, _, centre = name.partition("@")
    if centre:
        return _virtual_about(drawn_name, centre)
    kind, _, rest = name.partition(":")
    if is_drone(name):
        drone = parameters.replace(parameters.read_drone(name), time_step=0.001)
        law = law_for(parameters.full_scale_counts(name))
        return VirtualDrone(parameters.name_of(name), drone, thrust_law=law)
    if kind in VARIANTS:
        return virtual_drone(seed_of(name), kind)
    if rest and kind in REALITIES:
        return check_reality(REALITIES[kind](rest))
    if is_code(name):
        return _imported(kind, rest)
    raise InputError(
        f"{name}: no such reality.{_hint(kind, rest)} Expected "
        f"{', '.join(f'{variant}:SEED' for variant in VARIANTS)}, {VARIANTS[1]}:SEED@DRONE, "
        f"NAME:SEED or NAME:DRONE with {', '.join(REALITIES)}, MODULE:FACTORY, a drone's TOML "
        f"file, or {' or '.join(parameters.DRONES)}."
    )


def seed_of(name: str) -> int:
    """Returns the seed in a name such as `virtual:7`.

    Raises:
        InputError: there is none.
    """
    kind, _, seed = name.partition(":")
    if not seed.isdecimal():
        raise InputError(f"{name}: expected {kind}:SEED with a whole number, such as {kind}:7.")
    return int(seed)


def is_drone(name: str) -> bool:
    """Returns whether a reality's name is that of a drone or of a drone's file."""
    return name in parameters.DRONES or os.path.exists(name)


def imports_code(name: str) -> bool:
    """Tests whether a reality's name stands for Python code, `MODULE:FACTORY`, wherever it is read.

    A file of that name makes no difference: it may lie in one folder and not in another.
    """
    plain = additions.split(name)[0].partition("@")[0]
    return is_code(plain) and plain.partition(":")[0] not in (*VARIANTS, *REALITIES)


def _virtual_about(drawn_name: str, centre: str) -> VirtualDrone:
    kind, _, seed = drawn_name.partition(":")
    if kind not in VARIANTS or not seed.isdecimal():
        raise InputError(
            f"{drawn_name}@{centre}: expected one of "
            f"{', '.join(f'{variant}:SEED' for variant in VARIANTS)} before @, such as "
            "virtual:7@drone.toml."
        )
    law = law_for(parameters.full_scale_counts(centre))
    drone = virtual_drone(int(seed), kind, parameters.read_drone(centre), law)
    return dataclasses.replace(drone, name=f"{drone.name}@{parameters.name_of(centre)}")


def check_reality(candidate: Any) -> AnyReality:
    """Returns a reality, or that of a name.

    Raises:
        InputError: it is none.
    """
    if isinstance(candidate, str):
        return reality(candidate)
    if isinstance(candidate, AnyReality) and not isinstance(candidate, type):
        return candidate
    lacking = ", ".join(member for member in _MEMBERS if not hasattr(candidate, member))
    raise InputError(
        f"{str(candidate)[:60]!r} is no reality. Give what mf.virtual_drone(7) or mf.reality(NAME) "
        f"gives, or an instance of a Reality; this lacks {lacking or 'nothing but is a class'}."
    )


_MEMBERS = ("name", "rate", "hover", "takes", "reset", "step", "observe", "truth")


def _hint(kind: str, rest: str) -> str:
    own = [*VARIANTS, *parameters.DRONES]
    # Without a word behind it, a name as like a drone's as a simulator's is the drone's.
    similar = [] if rest else get_close_matches(kind, own, 1)
    similar = similar or get_close_matches(kind, [*own, *REALITIES], 1)
    if not similar:
        return ""
    if similar[0] in parameters.DRONES:
        return f" Did you mean {similar[0]}?"
    seed = rest if rest.isdecimal() or similar[0] not in VARIANTS else ""
    return f" Did you mean {similar[0]}:{seed or 7}?"


def _imported(module: str, factory: str) -> AnyReality:
    """What a factory in a module makes."""
    name = f"{module}:{factory}"
    try:
        make = import_part(name, "reality")
    except InputError as error:
        raise InputError(f"{error}{_hint(module, factory)}") from error
    if not callable(make):
        raise InputError(f"{name}: is no class or function that makes a reality.")
    try:
        return check_reality(make())
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
