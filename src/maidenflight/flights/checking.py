"""Checking flights: what can be used, what is dropped and why.

A flight is cut into gapless pieces of rows in which the drone really flies; the notes say what was left out.
"""

from dataclasses import replace

import numpy as np

from maidenflight.errors import InputError
from maidenflight.flights.log import GROUPS, Flight

STEEPEST = np.radians(60.0)
"""Roll or pitch beyond which a row counts as a crash [rad]."""
FASTEST = 25.0
"""Body rate beyond which a row counts as a crash [rad/s]."""
LOWEST = 0.1
"""Height below which a row may feel the ground [m]."""

_NEEDED = ("position", "velocity", "attitude", "body_rates", "command")


def pieces(flight: Flight, shortest: int = 50) -> tuple[list[Flight], list[str]]:
    """Cuts a flight into usable pieces.

    Args:
        flight: as read.
        shortest: rows that a piece must have to be kept.

    Returns:
        The pieces, and notes on what was dropped.

    Raises:
        InputError: a whole flight is in the wrong unit or range, so that dropping rows would hide a mistake.
    """
    _refuse_wrong_units(flight)
    finite = np.all([np.isfinite(getattr(flight, group)).all(axis=1) for group in _NEEDED], axis=0)
    faults = {
        "not a finite number": ~finite,
        f"tilt above {np.degrees(STEEPEST):.0f} deg": np.abs(flight.attitude[:, :2]).max(axis=1) > STEEPEST,
        f"body rate above {FASTEST:g} rad/s": np.abs(flight.body_rates).max(axis=1) > FASTEST,
        f"below {LOWEST:g} m": flight.position[:, 2] < LOWEST,
        "motors off": flight.command.max(axis=1) <= 0.0,
    }
    usable = np.ones(len(flight), bool)
    notes = []
    for fault, rows in faults.items():
        if (rows & usable).any():
            notes.append(f"{flight.name}: {int((rows & usable).sum())} rows dropped: {fault}")
        usable &= ~rows
    edges = np.flatnonzero(np.diff(np.concatenate([[False], usable, [False]]).astype(int)))
    kept = []
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        if stop - start >= shortest:
            kept.append(_rows(flight, start, stop))
        else:
            notes.append(f"{flight.name}: {stop - start} rows dropped: a piece shorter than {shortest * flight.period:g} s")
    return kept, notes


def _rows(flight: Flight, start: int, stop: int) -> Flight:
    return replace(flight, **{group: getattr(flight, group)[start:stop] for group in GROUPS if group != "time"})


def at_gaps(flight: Flight, time: np.ndarray) -> tuple[list[Flight], list[str]]:
    """Cuts a flight where rows are missing or time runs backwards.

    Args:
        flight: as read.
        time: time of each row [s].

    Raises:
        InputError: time is not finite, or most rows are not `flight.period` apart.
    """
    if not np.isfinite(time).all():
        raise InputError(f"{flight.name}: time is not a finite number in row {int(np.argmin(np.isfinite(time))) + 1}.")
    step = np.diff(time)
    regular = np.abs(step - flight.period) <= flight.period / 2
    if len(time) > 1 and (flight.period <= 0 or regular.mean() < 0.5):
        raise InputError(f"{flight.name}: rows are not equally spaced in time (median step {flight.period:g} s); log at a fixed rate.")
    cuts = [0, *(np.flatnonzero(~regular) + 1), len(flight)]
    notes = []
    if len(cuts) > 2:
        worst = int(np.argmax(np.abs(step - flight.period)))
        notes.append(f"{flight.name}: cut at {len(cuts) - 2} jumps of time (largest {step[worst]:.3f} s at t = {time[worst]:.2f} s)")
    return [_rows(flight, start, stop) for start, stop in zip(cuts[:-1], cuts[1:], strict=True)], notes


def _refuse_wrong_units(flight: Flight) -> None:
    tests = (
        ("roll, pitch", np.abs(flight.attitude[:, :2]), np.pi + 0.01, "rad", "degrees"),
        ("body_rate", np.abs(flight.body_rates), 100.0, "rad/s", "degrees a second"),
        ("command", np.abs(flight.command), 1.001, "a share of full thrust in [0, 1]", "PWM counts"),
        ("position", np.abs(flight.position), 500.0, "m", "millimetres"),
    )
    for name, values, largest, unit, wrong in tests:
        typical = np.nanquantile(values, 0.9) if np.isfinite(values).any() else np.nan
        if typical > largest:
            raise InputError(f"{flight.name}: {name} is typically {typical:.3g}; expected {unit}, it looks like {wrong}. Convert it.")
