"""When a drone flies, by its accelerometer, gyro and commands alone.

A log with a state estimate shows height and tilt; one without has to be cut in another way. Motors
that are off for a moment belong to a flight, since a pilot who cuts the throttle excites the motors
more than any other. What is left out: motors off for longer; standing on the ground with running
motors, where the body rates hardly change and less is commanded than flying takes; take-off and
landing beside both, where ground and air cushion carry; and impacts, short peaks of the force from
the side: drag may exceed 1 g for seconds, a crash lasts a tenth of one.
"""

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_dilation, binary_opening, median_filter, uniform_filter1d

from maidenflight.flights.log import GRAVITY, Flight

LONGEST_CUT = 0.5
"""Time for which motors may be off in a flight [s]."""
MOTORS_OFF = f"motors off for {LONGEST_CUT:g} s or longer"
"""Reason of rows for which they are off longer."""
TAKE_OFF, LANDING = 1.0, 0.5
"""Time after and before standing that is left out [s]."""
STILL_RAD_S = 0.02
"""Standard deviation of roll and pitch rates over `WINDOW` below which a drone stands: 0.009 to
0.022 with running motors on the ground, 0.028 and more in the calmest flights of the logs seen."""
STILL_M_S2 = 0.3
"""Distance of the mean specific force from gravity below which it does."""
IDLE = 0.8
"""Share of the command that flying takes below which a quiet drone stands: heavy quadrotors hover
as quietly as others stand."""
WINDOW, SMOOTHED = 0.5, 0.05
"""Time over which standing is judged, and over which vibration is averaged out [s]."""
IMPACT_M_S2 = GRAVITY
"""Specific force from the side, beyond its median about it, that tells of a hit."""
DRAG_S, RARE = 0.6, 0.25
"""Time of that median [s], and the share of rows beyond it from which it is no hit but shaking."""
VIBRATION = 0.03
"""Time over which the force from the side is averaged first [s]: some turns of a propeller."""
IMPACT_MARGIN = 0.3
"""Time before and after an impact that is left out [s]."""
LANDED = 1.0
"""Time by which autopilots say that they have landed later than they have [s]: PX4's
LNDMC_TRIG_TIME, ArduPilot's LAND_DETECTOR_TRIGGER_SEC."""
_IDLE_SHARE = 0.002
"""Share of the median command below which motors are off: what a mixer leaves of no throttle;
measured, idling ones take 0.01 of it and more."""


def faults(flight: Flight) -> dict[str, Bool[np.ndarray, "N"]]:
    """Returns rows in which a drone without a state estimate does not fly freely, by the reason."""
    off = _off(flight)
    ground = motors_off(flight)
    hit = _impacts(flight)
    stands = _stands(flight) & ~off
    beside = _rows_near(ground | stands, flight.period)
    about_hit = np.ones(2 * max(1, round(IMPACT_MARGIN / flight.period)) + 1)
    return {
        MOTORS_OFF: ground,
        "standing with running motors": stands,
        f"take-off or landing, {TAKE_OFF:g} s after and {LANDING:g} s before standing": beside,
        f"impact, a peak of {IMPACT_M_S2:g} m/s2 from the side": binary_dilation(hit, about_hit),
    }


def motors_off(flight: Flight) -> Bool[np.ndarray, "N"]:
    """Returns rows in which motors are off for longer than in a flight."""
    count = max(1, round(LONGEST_CUT / flight.period))
    padded = np.pad(_off(flight), count, mode="edge")
    return np.asarray(binary_opening(padded, np.ones(count)))[count:-count]


def _off(flight: Flight) -> Bool[np.ndarray, "N"]:
    most = flight.command.max(axis=1)
    on = most[most > 0]
    return most <= (_IDLE_SHARE * float(np.median(on)) if len(on) else 0.0)


def leave_out_ground(
    name: str, at: Float[np.ndarray, "N"], ground: Bool[np.ndarray, "N"]
) -> tuple[Bool[np.ndarray, "N"], list[str]]:
    """Returns rows in which an autopilot flies, without those beside the ground, and notes.

    Args:
        name: of the file, for notes.
        at: times of the rows [s].
        ground: rows in which it is disarmed or has landed, as it says.
    """
    if not ground.any():
        return ~ground, []
    on = at[ground]
    following = np.searchsorted(on, at)
    since = at - on[np.clip(following - 1, 0, None)]
    until = on[np.clip(following, None, len(on) - 1)] - at
    near = (since >= 0) & (since < TAKE_OFF)
    near |= (until >= 0) & (until < LANDED + LANDING)
    left = ground | near
    return ~left, [
        f"{name}: {int(left.sum())} of {len(at)} rows left out: disarmed or landed, "
        f"{TAKE_OFF:g} s after and {LANDED + LANDING:g} s before"
    ]


def _stands(flight: Flight) -> Bool[np.ndarray, "N"]:
    """Rows around which body rates do not change and the force is gravity."""
    if flight.accelerometer is None:
        return np.zeros(len(flight), bool)
    few, many = (max(1, round(time / flight.period)) for time in (SMOOTHED, WINDOW))
    # A running sum would carry one number that is not finite to all rows behind it.
    turns, pushes, sent = (
        np.nan_to_num(some.astype(float))
        for some in (flight.body_rates[:, :2], flight.accelerometer, flight.command)
    )
    rates = uniform_filter1d(turns, few, axis=0)
    mean, square = (uniform_filter1d(some, many, axis=0) for some in (rates, rates**2))
    deviation = np.sqrt(np.maximum(square - mean**2, 0.0))
    force = uniform_filter1d(np.linalg.norm(pushes, axis=1), many)
    quiet = (deviation < STILL_RAD_S).all(axis=1) & (np.abs(force - GRAVITY) < STILL_M_S2)
    quiet = np.asarray(binary_dilation(quiet, np.ones(many)), bool)
    mean_command = uniform_filter1d(sent.mean(axis=1), many)
    flying = mean_command[~quiet & (mean_command > 0.0)]
    if len(flying) * flight.period < 2 * WINDOW:
        flying = mean_command[mean_command > 0.0]
    return quiet & (mean_command < IDLE * np.median(flying)) if len(flying) else quiet


def _rows_near(rows: Bool[np.ndarray, "N"], period: float) -> Bool[np.ndarray, "N"]:
    """Rows shortly after and before some rows."""
    places = np.arange(len(rows))
    last = np.maximum.accumulate(np.where(rows, places, -np.inf))
    following = np.minimum.accumulate(np.where(rows, places, np.inf)[::-1])[::-1]
    near = (places - last) * period < TAKE_OFF
    return (near | ((following - places) * period < LANDING)) & ~rows


def _impacts(flight: Flight) -> Bool[np.ndarray, "N"]:
    """Rows of short peaks of the force from the side."""
    if flight.accelerometer is None:
        return np.zeros(len(flight), bool)
    side = np.nan_to_num(flight.accelerometer[:, :2].astype(float))
    # A raw accelerometer feels the propellers, to and fro within a few milliseconds.
    side = uniform_filter1d(side, max(1, round(VIBRATION / flight.period)), axis=0)
    # The median of every few rows is as good, and quick at any rate.
    every = max(1, round(0.01 / flight.period))
    count = 2 * round(DRAG_S / 2 / (every * flight.period)) + 1
    slow = median_filter(side[::every], (count, 1), mode="nearest")
    slow = np.repeat(slow, every, axis=0)[: len(side)]
    beyond = np.linalg.norm(side - slow, axis=1) > IMPACT_M_S2
    share = uniform_filter1d(beyond.astype(float), max(1, round(DRAG_S / flight.period)))
    return beyond & (share < RARE)
