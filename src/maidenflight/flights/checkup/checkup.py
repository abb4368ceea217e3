"""`check_up`, all tests of a log's conventions in the order in which they are shown.

A later test presumes what an earlier one found right, so that of several failures the first is
mended first.
"""

from collections.abc import Sequence

import numpy as np

from maidenflight.flights.checkup.columns import check_columns
from maidenflight.flights.checkup.gravity import check_accelerometer
from maidenflight.flights.checkup.in_flight import FLIGHT, check_flight
from maidenflight.flights.checkup.kinematics import check_state
from maidenflight.flights.checkup.motors import CURVE, ORDER, check_motors
from maidenflight.flights.checkup.one_drone import NAME as ONE_DRONE
from maidenflight.flights.checkup.one_drone import check_load
from maidenflight.flights.checkup.result import FAILS, PASSES, WARNS, CheckResult, unknown
from maidenflight.flights.checkup.rotor_speeds import check_rotor_speeds
from maidenflight.flights.log import Flight

_OF_FORCE = (FLIGHT, "thrust curve", "thrust to weight", ONE_DRONE)
_OF_AXES = ("body_rate", "accelerometer")
FEWEST_ROWS = 100
"""Rows of a log below which nothing is concluded."""

ASIDE = 0.3
"""Root mean square of the sine of yaw from which the test of tilt shows the sign of yaw."""


def check_up(pieces: Sequence[Flight]) -> tuple[CheckResult, ...]:
    """Checks the conventions of gapless pieces of one flight, however many of them.

    Returns:
        A result of each test that concerns what was logged; none of a log that is too short.
    """
    if sum(map(len, pieces)) < FEWEST_ROWS:
        return ()
    columns, flight = check_columns(pieces), check_flight(pieces)
    follows = flight.verdict == PASSES and (flight.statistic or 0.0) > CURVE[0]
    force = check_accelerometer(pieces, follows)
    if flight.verdict == FAILS and not any(result.is_failure for result in force):
        return *columns, flight
    state = check_state(pieces) if pieces[0].has_state else []
    verdicts = {result.name: result.verdict for result in state}
    yaw = np.concatenate([piece.attitude[:, 2] for piece in pieces]).astype(float)
    # Which way yaw counts shows in the way a tilt pushes only where the nose points aside.
    aside = float(np.sqrt(np.mean(np.nan_to_num(np.sin(yaw)) ** 2)))
    yaw_is_right = aside > ASIDE and verdicts.get("body_rate") == verdicts.get("tilt") == PASSES
    results = (*check_motors(pieces, yaw_is_right), check_load(pieces))
    results = (flight, *results)
    if wrong := [
        result.name for result in (*state, *force) if result.name in _OF_AXES if result.is_failure
    ]:
        # Turned axes of the sensors turn the order of the motors too.
        results = tuple(
            unknown(result.name, f"{wrong[0]} has to be mended first")
            if result.name == ORDER and result.is_failure
            else result
            for result in results
        )
    if any(result.verdict in (FAILS, WARNS) for result in force):
        # What follows from the force would repeat its fault.
        mend = "the accelerometer has to be mended first"
        results = tuple(
            unknown(result.name, mend) if result.name in _OF_FORCE else result for result in results
        )
    return *columns, *state, *force, *results, *check_rotor_speeds(pieces)
