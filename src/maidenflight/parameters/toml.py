"""Drones as TOML files that a person can read and change."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from maidenflight import budget, inputs, results
from maidenflight.errors import InputError, printable
from maidenflight.inputs import StrPath
from maidenflight.parameters import named
from maidenflight.parameters.components import check, plain
from maidenflight.parameters.frames import GEOMETRY, LAYOUTS
from maidenflight.parameters.named import DRONES, crazyflie, with_mass
from maidenflight.parameters.platforms import CRAZYFLIE, PLATFORMS
from maidenflight.parameters.quantities import QUANTITIES, Parameters

FORMAT = 7
"""Version of the TOML layout."""
_STILL = {
    name: list(quantity.paper) if quantity.size > 1 else quantity.paper
    for name, quantity in QUANTITIES.items()
    if quantity.table == "disturbance"
}
"""What a file without that table says."""
_LARGEST = float(np.finfo(np.float32).max)


def to_toml(
    parameters: Parameters,
    name: str,
    extra: Mapping[str, Any] | None = None,
    sources: Mapping[str, str] | None = None,
) -> str:
    """Returns the TOML text of one drone, its units, symbols and sources as comments.

    Args:
        parameters: a point, without batch axes.
        name: what to call the drone.
        extra: further tables for the end of the file, such as `identification` or `record`.
        sources: of values, by field; the paper's where they are its values, by default.

    Returns:
        Text that `from_toml` reads back to the same float32 values.
    """
    check(parameters, name)
    document = tomlkit.document()
    document.add(tomlkit.comment("A quadrotor's parameters, SI units."))
    document.add("format", tomlkit.item(FORMAT))
    document.add("name", tomlkit.item(name))
    platform = tomlkit.item(parameters.platform)
    platform.comment(f"gains of the firmware's inner loops: {', '.join(PLATFORMS)}")
    document.add("platform", platform)
    tables: dict[str, Any] = {}
    paper = crazyflie()
    for field_name, quantity in QUANTITIES.items():
        if quantity.table not in tables:
            tables[quantity.table] = tomlkit.table()
        value, known = plain(getattr(parameters, field_name)), plain(getattr(paper, field_name))
        entry = tomlkit.item(value)
        # The source is of the named drone's value, not of another.
        source = quantity.source if value == known else f"crazyflie: {known}, {quantity.source}"
        source = (sources or {}).get(field_name, source)
        entry.comment(f"{quantity.symbol} [{quantity.unit}] {quantity.meaning} ({source})")
        tables[quantity.table].add(field_name, entry)
    for title, table in tables.items():
        document.add(tomlkit.nl())
        document.add(title, table)
    for title, content in (extra or {}).items():
        document.add(tomlkit.nl())
        document.add(title, tomlkit.item(content))
    return tomlkit.dumps(document)


def from_toml(text: str, source: str = "drone.toml") -> Parameters:
    """Reads one drone from TOML text; see `from_document` for the errors."""
    return from_document(_parsed(text, source), source)


def _parsed(text: str, source: str) -> dict[str, Any]:
    try:
        return inputs.from_toml(text)
    except ValueError as error:  # TOMLDecodeError, or a number of more digits than Python reads
        raise InputError(
            f"{source}: not valid TOML: {error}. Mend it there, or write the file again."
        ) from error


def from_document(document: Mapping[str, Any], source: str) -> Parameters:
    """Takes the parameters from what a drone's TOML file says.

    In [body], `layout = "x"` or `"+"` with `arm_length` [m] stand for the places and directions of
    the rotors.

    Args:
        document: the file's content.
        source: the file's name, for errors.

    Raises:
        InputError: an unknown format or key, a missing value, a value that is no number or outside
            its physical range.
    """
    layout = document.get("format")
    if type(layout) is not int or layout != FORMAT:
        now = "; rotor_x, rotor_y and rotor_direction are what arm_length was"
        raise InputError(
            f"{source}: format = {str(layout)[:40]}, expected {FORMAT}. If it is a drone file of "
            f"another version, identify or write the drone again{now if layout == 4 else ''}."
        )
    astray = next((name for name in document if name in QUANTITIES), None)
    if astray:
        raise InputError(
            f"{source}: {astray} stands outside its table. Put it into "
            f"[{QUANTITIES[astray].table}]."
        )
    fields: dict[str, Any] = {}
    for table in dict.fromkeys(quantity.table for quantity in QUANTITIES.values()):
        content = document.get(table, _STILL if table == "disturbance" else {})
        if not isinstance(content, dict):
            raise InputError(f"{source}: {table} is a value, expected a table [{table}].")
        if table == "body":
            content = _laid_out(content, source)
        for name, value in content.items():
            if name not in QUANTITIES or QUANTITIES[name].table != table:
                raise InputError(f"{source}: unknown key {name!r} in [{table}]{_suggestion(name)}")
            fields[name] = _numbers(value, name, source)
    missing = [name for name in QUANTITIES if name not in fields]
    if missing:
        raise InputError(
            f"{source}: missing {', '.join(missing)}. Start from a complete file: maidenflight "
            "drone crazyflie -o mine.toml."
        )
    return check(Parameters(**fields, platform=document.get("platform", CRAZYFLIE)), source)


def _laid_out(body: Mapping[str, Any], source: str) -> Mapping[str, Any]:
    """What the table [body] says, with a `layout` and its `arm_length` as places of the rotors."""
    geometry = {name: body[name] for name in ("layout", "arm_length") if name in body}
    if not geometry:
        return body
    twice = [name for name in GEOMETRY if name in body]
    layout, arm = geometry.get("layout"), geometry.get("arm_length")
    known = layout if isinstance(layout, str) and layout in LAYOUTS else None
    if twice or known is None or not isinstance(arm, float | int) or isinstance(arm, bool):
        raise InputError(
            f"{source}: layout = {layout!r} and arm_length = {arm!r}"
            f"{f' beside {twice[0]}' if twice else ''}. Give either both, layout as one of "
            f"{', '.join(map(repr, LAYOUTS))} and arm_length [m] from the centre to a rotor, or "
            f"{', '.join(GEOMETRY)} of the four rotors."
        )
    try:
        frame = LAYOUTS[known](float(arm))
    except InputError as error:
        raise InputError(f"{source}: {error}") from error
    rest = {name: value for name, value in body.items() if name not in geometry}
    return {**rest, **{name: list(values) for name, values in frame.items()}}


def _suggestion(name: str) -> str:
    import difflib

    close = difflib.get_close_matches(name, QUANTITIES, n=1)
    return f"; did you mean {close[0]!r} in [{QUANTITIES[close[0]].table}]?" if close else "."


def _numbers(value: Any, name: str, source: str) -> Any:
    entries = value if isinstance(value, list) else [value]
    if not all(isinstance(entry, float | int) and not isinstance(entry, bool) for entry in entries):
        raise InputError(
            f"{source}: {name} = {value!r}, expected "
            f"{f'{QUANTITIES[name].size} numbers' if QUANTITIES[name].size > 1 else 'a number'}."
        )
    if isinstance(value, list) != (QUANTITIES[name].size > 1):
        raise InputError(
            f"{source}: {name} has {len(entries)} values, expected {QUANTITIES[name].size}."
        )
    if any(_LARGEST < abs(entry) < math.inf for entry in entries):
        raise InputError(
            f"{source}: {name} = {str(value)[:40]} is outside what a number here can be. Check the "
            "unit; values are SI."
        )
    return tuple(map(float, entries)) if isinstance(value, list) else float(value)


def write_drone(
    path: StrPath, parameters: Parameters, extra: Mapping[str, Any] | None = None
) -> Path:
    """Writes one drone as a TOML file named after it; see `to_toml`."""
    return results.write(path, to_toml(parameters, Path(path).stem, extra))


def document(path: StrPath) -> dict[str, Any]:
    """Returns what a drone's TOML file says.

    Raises:
        InputError: no file that can be read as text, or not TOML.
    """
    try:
        text = inputs.text(path, budget.TOML)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"{path}: no such drone; give a TOML file or one of: {', '.join(DRONES)}."
        ) from error
    except ValueError as error:
        raise InputError(f"{path}: not a drone's TOML file ({error}). Give another.") from error
    return _parsed(text, str(path))


def read_drone(drone: StrPath, mass: float | None = None) -> Parameters:
    """Reads a drone's parameters from its TOML file, or returns a named drone.

    What else an identified drone's file says, `identification.drone_file` reads.

    Args:
        drone: TOML file, or a name in `DRONES`.
        mass: of what flies [kg]; the drone's own by default. Inertia and thrust-to-weight ratio
            follow it.

    Raises:
        InputError: neither a named drone nor a readable, valid file; or the mass is needed, or is
            more than the drone lifts.
    """
    if str(drone) in DRONES:
        return named.drone(str(drone), mass)
    parameters = from_document(document(drone), str(drone))
    return parameters if mass is None else with_mass(parameters, mass, str(drone))


def full_scale_counts(drone: StrPath) -> float | None:
    """Returns the firmware counts of u = 1 in the flights of an identified drone.

    None of any other.

    Args:
        drone: TOML file that `read` takes, or a name in `DRONES`.
    """
    content: Any = {} if str(drone) in DRONES else document(drone)
    for table in ("identification", "source", "full_scale_counts"):
        content = content.get(table) if isinstance(content, dict) else None
    return float(content) if isinstance(content, int | float) else None


def name_of(drone: StrPath) -> str:
    """Returns what to call a drone: its name, or its file's name without the ending."""
    return str(drone) if str(drone) in DRONES else printable(Path(drone).stem)
