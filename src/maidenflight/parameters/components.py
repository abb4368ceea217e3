"""The numbers of a drone one by one: read, replaced and checked by their names."""

import dataclasses
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from maidenflight.errors import InputError
from maidenflight.parameters import frames
from maidenflight.parameters.platforms import platform_of
from maidenflight.parameters.quantities import QUANTITIES, Parameters


def part_names(size: int) -> str:
    """Returns what the parts of a vector are called: its axes, or the numbers of four motors."""
    return "xyz"[:size] if size <= 3 else "1234"


COMPONENTS: dict[str, tuple[str, int | None]] = {
    **{name: (name, None) for name, quantity in QUANTITIES.items() if quantity.size == 1},
    **{
        f"{name}_{axis}": (name, index)
        for name, quantity in QUANTITIES.items()
        if quantity.size > 1
        for index, axis in enumerate(part_names(quantity.size))
    },
}
"""Every single number of `Parameters` by name, such as `latency`, `inertia_x` or `rotor_thrust_1`:
its field, and its place in it if that is a vector."""


def check_names(names: Iterable[str]) -> None:
    """Refuses what is no parameter, with those that may be meant: the whole list is long.

    Raises:
        InputError: a name is none of `COMPONENTS`.
    """
    for name in names:
        if name in COMPONENTS:
            continue
        alike = [
            *(known for known in COMPONENTS if name and name in known),
            *get_close_matches(name, COMPONENTS, 3),
        ]
        hint = f" Did you mean {' or '.join(dict.fromkeys(alike[:3]))}?" if alike else ""
        raise InputError(
            f"unknown parameter {name!r}.{hint} All are in what this prints: maidenflight drone "
            "crazyflie."
        )


def component(parameters: Parameters, name: str) -> Any:
    """Returns one number of a drone, by a name of `COMPONENTS`."""
    field_name, index = COMPONENTS[name]
    value = getattr(parameters, field_name)
    return value if index is None else value[..., index]


def replace(parameters: Parameters, /, **changes: Any) -> Parameters:
    """Returns a copy with some fields changed, or single components of them such as `inertia_x`.

    Raises:
        InputError: no field has that name.
    """
    for name in changes:
        if name not in QUANTITIES and name not in COMPONENTS and name != "platform":
            raise InputError(f"unknown parameter {name!r}; known are {', '.join(QUANTITIES)}.")
    vectors: dict[str, list[Any]] = {}
    for name in [name for name in changes if name in COMPONENTS and name not in QUANTITIES]:
        field_name, index = COMPONENTS[name]
        parts = vectors.setdefault(
            field_name,
            [
                getattr(parameters, field_name)[..., axis]
                for axis in range(QUANTITIES[field_name].size)
            ],
        )
        parts[index if index is not None else 0] = changes.pop(name)
    stacked = {name: _stacked(parts) for name, parts in vectors.items()}
    return dataclasses.replace(parameters, **changes, **stacked)


def _stacked(parts: Sequence[Any]) -> Any:
    """A vector of its parts; by JAX, which takes longer outside of a program, only if one is."""
    if any(isinstance(part, jax.Array) for part in parts):
        return jnp.stack(jnp.broadcast_arrays(*parts), axis=-1)
    return np.stack(np.broadcast_arrays(*parts), axis=-1).astype(np.float32)


def noiseless(parameters: Parameters) -> Parameters:
    """Returns the same drone with perfect sensors and motors without noise."""
    sizes = [
        name
        for name in QUANTITIES
        if ("noise" in name and not name.endswith("rate")) or name.endswith("_walk")
    ]
    further = "gyro_turn_on_bias", "turn_drift"
    return calm(replace(parameters, **dict.fromkeys([*sizes, *further], np.float32(0.0))))


def calm(parameters: Parameters) -> Parameters:
    """Returns the same drone without disturbances."""
    sizes = "disturbance_torque", "disturbance_force"
    return replace(parameters, **{name: 0.0 * getattr(parameters, name) for name in sizes})


def check(parameters: Parameters, source: str = "parameters") -> Parameters:
    """Returns one drone's parameters if every value lies in its physical range.

    Args:
        parameters: a point, without batch axes.
        source: what the error names, usually a file.

    Raises:
        InputError: a value is not a finite number, has the wrong number of components or is out of
            range, or the rotors cannot steer the drone.
    """
    for name, quantity in QUANTITIES.items():
        value = np.asarray(getattr(parameters, name))
        if value.shape != (() if quantity.size == 1 else (quantity.size,)):
            raise InputError(
                f"{source}: {name} has shape {value.shape}, expected "
                f"{'one number' if quantity.size == 1 else f'{quantity.size} numbers'}."
            )
        if not (
            np.all(np.isfinite(value))
            and np.all(value >= quantity.lower)
            and np.all(value <= np.float32(quantity.upper))
        ):
            raise InputError(
                f"{source}: {name} = {plain(value)} {quantity.unit} is outside its physical range"
                f" [{quantity.lower:g}, {quantity.upper:g}]. Check the unit; values are SI."
            )
    platform_of(parameters.platform, source)
    return frames.check(parameters, source)


def plain(value: Any) -> Any:
    """Rounds a float32 to the shortest decimal that reads back as the same float32."""
    array = np.asarray(value, dtype=np.float32)
    return [float(str(entry)) for entry in array] if array.ndim else float(str(array))
