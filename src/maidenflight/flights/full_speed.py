"""Rotor speed at full command, from flights whose logs have measured speeds."""

from collections.abc import Sequence

import numpy as np

from maidenflight.errors import InputError
from maidenflight.flights.log import Flight
from maidenflight.flights.trims import rotors
from maidenflight.parameters import Parameters

TURNING = 0.3
"""Of full speed, above which a row counts, chosen: idling rotors say little."""


def full_speed(flights: Sequence[Flight], drone: Parameters, source: str) -> float:
    """Returns the rotors' speed at u = 1 [rad/s], the median of what rows say.

    Args:
        flights: logs; those without measured speeds say nothing.
        drone: whose motors follow the logged commands.
        source: of the logs, for errors.

    Raises:
        InputError: no log has measured rotor speeds.
    """
    ratios = []
    for flight in flights:
        if flight.rotor_speed is None:
            continue
        # The measured speed is that of the row's beginning, the simulated one that of its end.
        share = rotors(flight, drone).speed[:-1]
        measured = np.asarray(flight.rotor_speed)[1:]
        with np.errstate(invalid="ignore"):
            ratios.append((measured / share)[(share > TURNING) & (measured > 0.0)])
    if not sum(map(len, ratios)):
        raise InputError(
            f"{source}: no log has measured rotor speeds. Give logs that have them, or a number: "
            "--full-speed RPM."
        )
    return float(np.median(np.concatenate(ratios)))
