"""Checking flights: what can be used, what is dropped and why.

A flight is cut into gapless pieces of rows in which the drone really flies; the notes say what was
left out, and from which row on. A wrong unit of a whole flight is refused: dropping rows would hide
it. Signs, frames, clocks and the order of the motors are judged by `checkup`.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from maidenflight.errors import InputError
from maidenflight.flights.checks import airborne, resampling
from maidenflight.flights.checks.speed_readings import mend_rotor_speeds
from maidenflight.flights.log import GROUPS, OPTIONAL, Flight
from maidenflight.simulator.physics.battery import LARGEST_COMMAND

MAX_TILT_RAD = np.radians(60.0)
"""Roll or pitch beyond which a row counts as a crash [rad]."""
MAX_BODY_RATE_RAD_S, GYRO_RANGE_RAD_S = 25.0, 34.9
"""Body rate beyond which a row counts as a crash, and the range of a gyro, 2000 deg/s (Crazyflie
firmware, sensors_bmi088_bmp3xx.c), the limit in logs without a state, of acrobatics [rad/s]."""
SHORTEST_S, SHORTEST_ROWS = 0.5, 50
"""Time [s] and rows that a piece must have."""
FASTEST_S = 2e-5
"""Step of time below which no sensor is read [s]."""
MIN_HEIGHT_M = 0.1
"""Height below which a row may feel the ground [m]."""
LEAP = 0.25
"""Change of position between two rows, beyond that by velocity, that is a jump of the estimate
[m]."""
TWIST = 0.5
"""Change of roll or pitch between two rows, beyond that by body rates, that is a jump of the
estimate [rad]."""
STILL = 20
"""Rows that are equal in every column before the log counts as standing still."""
EMPTY = 2.8
"""Battery voltage of a cell below which a Crazyflie's firmware can no longer make up for it: u = 1
asks for 2.95 V at the motors [V]."""

_RUNAWAY = 50
"""Rows in which body rates never come back before their end is cut off."""
_MAX_SETPOINT_M = 1e6
"""Set-point beyond which it is none [m]."""
_STATE = ("position", "velocity", "attitude")
_COLUMNS = GROUPS | OPTIONAL


def pieces(
    flight: Flight, time: Float[np.ndarray, "N"] | None = None, shortest: int = 0
) -> tuple[list[Flight], list[str]]:
    """Cuts a flight into usable pieces.

    Args:
        flight: as read.
        time: time of each row [s]; equally spaced by default.
        shortest: rows that a piece must have; 0 is `SHORTEST_S`.

    Returns:
        The pieces, and notes on what was dropped.

    Raises:
        InputError: the rate is not steady, or a whole flight is in the wrong unit.
    """
    cuts, notes = np.zeros(len(flight), bool), []
    if 0 < flight.period < FASTEST_S:
        raise InputError(
            f"{flight.name}: rows are {1e6 * flight.period:.3g} us apart in the median, which no "
            "drone logs; expected seconds. The clock counts something else: convert time."
        )
    least = max(SHORTEST_ROWS, round(SHORTEST_S / flight.period)) if flight.period > 0 else 1
    shortest = shortest or least
    if time is not None:
        flight, time, filled = resampling.bridged(flight, time)
        flight, time, evened = resampling.resampled(flight, time)
        cuts, jumps = _cuts(flight, time)
        notes = [*filled, *evened, *jumps]
    flight, runaway = _before_runaway(flight)
    cuts = cuts[: len(flight)]
    notes += runaway
    _refuse_wrong_units(flight)
    flight, unknown = _blanked(flight)
    flight, mended = mend_rotor_speeds(flight)
    notes += [*unknown, *mended]
    usable = np.ones(len(flight), bool)
    for fault, rows in _faults(flight, cuts).items():
        new = rows & usable
        if new.any():
            notes.append(
                f"{flight.name}: {int(new.sum())} rows dropped: {fault} (first: row "
                f"{int(new.argmax()) + 1})"
            )
        usable &= ~rows
    pieces: list[Flight] = []
    short: list[int] = []
    for start, stop in _runs(usable, cuts):
        if stop - start >= shortest:
            pieces.append(flight.part(start, stop))
        else:
            short.append(stop - start)
    if short:
        pieces_text = "a piece" if len(short) == 1 else f"{len(short)} pieces"
        notes.append(
            f"{flight.name}: {sum(short)} rows dropped: {pieces_text} shorter than "
            f"{shortest * flight.period:.3g} s"
        )
    pieces, constant = _without_constants(pieces, flight.name)
    notes += constant
    weak = sum(int((piece.battery < EMPTY).sum()) for piece in pieces if piece.by_battery_law)
    if weak:
        notes.append(
            f"{flight.name}: {weak} rows kept with the battery below {EMPTY:g} V, where the "
            "firmware can no longer make up for it"
        )
    return pieces, notes


def _greatest_rate(flight: Flight) -> float:
    return MAX_BODY_RATE_RAD_S if flight.has_state else GYRO_RANGE_RAD_S


def _before_runaway(flight: Flight) -> tuple[Flight, list[str]]:
    """Returns the flight without an end in which no body rate is possible, and a note on it.

    In a wrong unit rates are too large as well, but pass through zero now and then.
    """
    with np.errstate(invalid="ignore"):
        wild = np.abs(flight.body_rates).max(axis=1) > _greatest_rate(flight)
    sound = np.flatnonzero(~wild)
    end = int(sound[-1]) + 1 if len(sound) else 0
    lost = len(flight) - end
    if lost < _RUNAWAY or end < lost / 10 or wild[:end].mean() > 0.1:
        return flight, []
    note = (
        f"{flight.name}: {lost} rows dropped: body rates run away above "
        f"{_greatest_rate(flight):g} rad/s until the end (first: row {end + 1})"
    )
    return flight.part(0, end), [note]


def _blanked(flight: Flight) -> tuple[Flight, list[str]]:
    """Returns the flight without impossible numbers in what may be unknown, and notes on them."""
    with np.errstate(invalid="ignore"):
        odd = {
            "battery": (flight.battery < 0) | (flight.battery > 100),
            "setpoint": np.abs(flight.setpoint) > _MAX_SETPOINT_M,
        }
    notes = [
        f"{flight.name}: {int(rows.sum())} impossible numbers in {group} taken as unknown (first: "
        f"row {int(np.argwhere(rows)[0][0]) + 1})"
        for group, rows in odd.items()
        if rows.any()
    ]
    known = {
        group: np.where(rows, np.float32(np.nan), getattr(flight, group))
        for group, rows in odd.items()
    }
    return replace(flight, **known), notes


def _faults(flight: Flight, cuts: Bool[np.ndarray, "N"]) -> dict[str, Bool[np.ndarray, "N"]]:
    """Rows that are of no use, by the reason."""
    finite = {group: np.isfinite(getattr(flight, group)) for group in _needed(flight)}
    odd = [
        _COLUMNS[group][column]
        for group, sound in finite.items()
        for column in np.flatnonzero(~sound.all(axis=0))
    ]
    names = ", ".join(odd[:3]) + (" ..." if len(odd) > 3 else "")
    attitude, rates, command = flight.attitude[:, :2], flight.body_rates, flight.command
    with np.errstate(invalid="ignore", over="ignore"):  # what is not finite is a fault already
        unknown = ~np.all([sound.all(axis=1) for sound in finite.values()], axis=0)
        tilted = np.abs(attitude).max(axis=1) > MAX_TILT_RAD
        spinning = np.abs(rates).max(axis=1) > _greatest_rate(flight)
        beyond = (command < -0.001).any(axis=1) | (command > LARGEST_COMMAND).any(axis=1)
        grounded = {
            f"below {MIN_HEIGHT_M:g} m": flight.position[:, 2] < MIN_HEIGHT_M,
            airborne.MOTORS_OFF: airborne.motors_off(flight),
        }
        faults = {
            f"not a finite number in {names}": unknown,
            f"tilt above {np.degrees(MAX_TILT_RAD):.0f} deg": tilted,
            f"body rate above {_greatest_rate(flight):g} rad/s": spinning,
            **(grounded if flight.has_state else airborne.faults(flight)),
            f"command outside [0, {LARGEST_COMMAND:g}]": beyond,
            "every column stands still": _still(flight),
        }
        sound = ~np.any(list(faults.values()), axis=0)
        follows = sound & np.concatenate([[False], sound[:-1]]) & ~cuts
        leaps = follows & _jumps(flight.position, flight.velocity, flight.period, LEAP)
        twists = follows & _jumps(attitude, rates[:, :2], flight.period, TWIST)
    for jumps, signals in ((leaps, "position and velocity"), (twists, "attitude and body rates")):
        if jumps.sum() > max(20, 0.05 * follows.sum()):
            raise InputError(
                f"{flight.name}: {signals} contradict each other in {int(jumps.sum())} of "
                f"{int(follows.sum())} rows, first in row {int(jumps.argmax()) + 1}; expected SI "
                "units and rows in order. Convert one."
            )
    return faults | {
        f"position jumps by more than {LEAP:g} m": leaps,
        f"attitude jumps by more than {TWIST:g} rad": twists,
    }


def _needed(flight: Flight) -> tuple[str, ...]:
    """Groups that every row must have: the state if it was logged, the sensors, commands."""
    state = _STATE if flight.has_state else ()
    optional = (group for group in OPTIONAL if group in flight.arrays)
    return *state, "body_rates", "command", *optional


def _jumps(
    state: np.ndarray, rate: np.ndarray, period: float, largest: float
) -> Bool[np.ndarray, "N"]:
    """Rows that are farther from the row before than the rate explains."""
    beyond = np.abs(np.diff(state, axis=0)) - period * np.abs(rate[1:] + rate[:-1]) / 2
    return np.concatenate([[False], beyond.max(axis=1) > largest])


def _still(flight: Flight) -> Bool[np.ndarray, "N"]:
    """Rows that repeat the row before, `STILL` or more in a row: no sensor is that quiet."""
    values = np.concatenate([getattr(flight, group) for group in _needed(flight)], axis=1)
    same = np.concatenate([[False], (values[1:] == values[:-1]).all(axis=1)])
    still = np.zeros(len(flight), bool)
    for start, stop in _runs(same, np.zeros(len(flight), bool)):
        still[start:stop] = stop - start >= STILL - 1
    return still


def _runs(rows: Bool[np.ndarray, "N"], cuts: Bool[np.ndarray, "N"]) -> list[tuple[int, int]]:
    """Stretches (start, stop) of true rows; each cut begins another."""
    before = np.concatenate([[False], rows[:-1]])
    after = np.concatenate([rows[1:], [False]])
    ends = ~after | np.concatenate([cuts[1:], [False]])
    starts = np.flatnonzero(rows & (~before | cuts))
    return list(zip(starts.tolist(), (np.flatnonzero(rows & ends) + 1).tolist(), strict=True))


def _cuts(flight: Flight, time: Float[np.ndarray, "N"]) -> tuple[Bool[np.ndarray, "N"], list[str]]:
    """Rows before which others are missing or time runs backwards, and a note on them."""
    if not np.isfinite(time).all():
        raise InputError(
            f"{flight.name}: time is not a finite number in row "
            f"{int(np.argmin(np.isfinite(time))) + 1}. Mend or drop it."
        )
    step = np.diff(time)
    if len(step) and flight.period <= 0:
        fault = "stands still" if flight.period == 0 else "runs backwards"
        row = int(np.argmax(step <= 0)) + 2
        raise InputError(
            f"{flight.name}: rows are not equally spaced in time, which {fault} (from row {row}). "
            "Log at a fixed rate."
        )
    if flight.period >= 1:
        unit = "milliseconds" if flight.period < 1000 else "microseconds"
        raise InputError(
            f"{flight.name}: rows are {flight.period:g} s apart; expected seconds, it looks like "
            f"{unit}. Convert time."
        )
    regular = np.abs(step - flight.period) <= flight.period / 2
    if len(step) and regular.mean() < 0.5:
        raise InputError(
            f"{flight.name}: rows are not equally spaced in time (median step {flight.period:g} "
            "s); log at a fixed rate."
        )
    cuts = np.concatenate([[False], ~regular])
    if not cuts.any():
        return cuts, []
    worst = int(np.argmax(np.abs(step - flight.period)))
    largest = f"largest {step[worst]:.3f} s at t = {time[worst]:.2f} s, row {worst + 2}"
    jumps = "a jump" if cuts.sum() == 1 else f"{cuts.sum()} jumps"
    return cuts, [f"{flight.name}: cut at {jumps} of time ({largest})"]


def _without_constants(pieces: list[Flight], name: str) -> tuple[list[Flight], list[str]]:
    """Passes over what a log need not have and never changes, with a note."""
    notes = []
    if sum(map(len, pieces)) < 100:
        return pieces, notes
    for group in _needed(pieces[0]):
        first = getattr(pieces[0], group)[0]
        if not all((getattr(piece, group) == first).all() for piece in pieces):
            continue
        rows = sum(map(len, pieces))
        note = f"{name}: {', '.join(_COLUMNS[group])} never change in {rows} rows; "
        alone = not np.isfinite(pieces[0].position).any()
        if group not in OPTIONAL or (group == "accelerometer" and alone):
            raise InputError(f"{note}nothing was measured. Leave it out.")
        notes.append(f"{note}nothing was measured, and they are passed over")
        pieces = [replace(piece, **{group: None}) for piece in pieces]
    return pieces, notes


def _refuse_wrong_units(flight: Flight) -> None:
    rates, command = np.abs(flight.body_rates), flight.command
    share, counts = "a share of full thrust, about 0.5 in hover", "PWM counts or percent"
    actions = "actions a in [-1, 1], of which u = (a + 1) / 2"
    tests = (
        ("roll, pitch", np.abs(flight.attitude[:, :2]), np.pi + 0.01, "rad", "degrees"),
        ("body_rate", rates, 100.0, "rad/s", "degrees a second"),
        ("body_rate", _median(rates.max(axis=1)), 12.0, "rad/s", "degrees a second"),
        ("command", np.abs(command), LARGEST_COMMAND, share, counts),
        ("command", -command, 0.001, "a share of full thrust from 0", actions),
        ("position", np.abs(flight.position), 500.0, "m", "millimetres"),
        ("velocity", np.abs(flight.velocity), 100.0, "m/s", "millimetres a second"),
        ("battery", flight.battery, 100.0, "V", "millivolts"),
    )
    heights = flight.position[:, 2][np.isfinite(flight.position[:, 2])]
    if len(heights) and np.quantile(heights, 0.9) < -MIN_HEIGHT_M:
        raise InputError(
            f"{flight.name}: position_z is typically {np.median(heights):.3g}; expected metres "
            "above the ground, it looks like z down (NED). Turn the signs of y and z of position, "
            "velocity and body rates, and of pitch and yaw."
        )
    for name, values, largest, unit, wrong in tests:
        finite = values[np.isfinite(values)]
        typical = np.quantile(finite, 0.9) if len(finite) else np.nan
        if typical > largest:
            raise InputError(
                f"{flight.name}: {name} is typically {typical:.3g}; expected {unit}, it looks "
                f"like {wrong}. Convert it."
            )


def _median(values: np.ndarray) -> np.ndarray:
    """Returns the median of what is finite; a crash may spin for a while, a flight does not."""
    finite = values[np.isfinite(values)]
    return np.median(finite, keepdims=True) if len(finite) else finite
