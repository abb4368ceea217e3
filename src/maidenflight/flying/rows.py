"""What is logged of a simulated flight, and the `Flight` log that is made of it."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from maidenflight.flights.log import GYRO_DELAY, Flight
from maidenflight.parameters import Parameters
from maidenflight.simulator.physics import battery
from maidenflight.simulator.physics.battery import Supply
from maidenflight.simulator.tasks import failures
from maidenflight.simulator.tasks.failures import END_REASONS, TIME_LIMIT, End, Excursion, Guard


class Rows(NamedTuple):
    """What is logged of N control periods: the rows of `Flight`, and the true state."""

    position: Float[Array, "N 3"]
    velocity: Float[Array, "N 3"]
    attitude: Float[Array, "N 3"]
    body_rates: Float[Array, "N 3"]
    ratio: Float[Array, "N 4"]
    """Motor ratio; the thrust command where no battery is simulated. That of the row's own period
    where a command holds for it, else that in force when the row was measured."""
    battery: Float[Array, "N"]
    setpoint: Float[Array, "N 3"]
    true_position: Float[Array, "N 3"]
    """At the end of the period [m]."""
    true_setpoint: Float[Array, "N 3"]
    """At the end of the period [m]."""
    true_attitude: Float[Array, "N 3"]
    true_body_rates: Float[Array, "N 3"]
    true_velocity: Float[Array, "N 3"]
    """At the end of the period [m/s]; NaN where a reality does not tell."""
    rotor_speed: Float[Array, "N 4"]
    """nu when the row was measured [-]; NaN where a reality does not tell."""

    def excursion(self, estimated: bool = False) -> Excursion:
        """Returns how far the drone is from hover at the set-point, in each period.

        By the true state at its end; or by the estimates at its beginning, as the drone's own
        guards see it.
        """
        judged = self.true_position, self.true_attitude, self.true_body_rates, self.true_setpoint
        if estimated:
            judged = self.position, self.attitude, self.body_rates, self.setpoint
        return failures.excursion(*(np.asarray(part) for part in judged))

    def end(self, guard: Guard, estimated: bool = False) -> End:
        """Returns when a guard ends the flight, and why; see `excursion`."""
        return failures.first_end(failures.reason(**guard.trips(self.excursion(estimated))))


@dataclass(frozen=True, eq=False)
class SimulatedFlight:
    """A simulated flight."""

    rows: Rows
    """Up to its end."""
    rate: int
    """Rows a second [Hz]."""
    zero_order_hold: bool
    """Whether a motor command holds for the whole period between two rows."""
    supply: Supply
    """What became of thrust commands before the motors."""
    reality: str
    """Name of the reality."""
    reason: int = TIME_LIMIT
    """Why it ended, an index of `END_REASONS`."""
    drone: Parameters | None = None
    """The virtual drone that flew, where one did."""
    estimated: bool = False
    """Whether it is judged by the drone's estimates, because they drift."""

    @property
    def excursion(self) -> Excursion:
        """How far the drone is from hover at the set-point, in each period."""
        return self.rows.excursion(self.estimated)

    @property
    def end_reason(self) -> str:
        """One of `END_REASONS`."""
        return END_REASONS[self.reason]

    @property
    def duration(self) -> float:
        """[s]."""
        return len(self.rows.position) / self.rate

    def to_flight(self, name: str) -> Flight:
        """Returns its log.

        The command is computed from the motor ratio by the law of the supply, as for a real log.
        """
        logged: Any = jax.tree.map(np.asarray, self.rows)
        supply, drone = self.supply, self.drone
        delay = GYRO_DELAY if drone is None else float(drone.gyro_time_constant)
        command = battery.thrust_command(logged.ratio, logged.battery[:, None], supply)
        return Flight(
            name=name,
            period=1 / self.rate,
            **{signal: getattr(logged, signal) for signal in _LOGGED},
            command=np.asarray(command),
            full_scale_counts=supply.full_scale_counts,
            zero_order_hold=self.zero_order_hold,
            simulated=self.reality,
            gyro_delay=delay,
            gyro_delay_known=drone is not None,
            true_position=_at_rows(logged.true_position, logged.true_velocity, 1 / self.rate),
        )


_LOGGED = ("position", "velocity", "attitude", "body_rates", "battery", "setpoint")


def _at_rows(
    position: Float[np.ndarray, "N 3"], velocity: Float[np.ndarray, "N 3"], period: float
) -> Float[np.ndarray, "N 3"]:
    """True positions when the rows were measured, at the end of the period before."""
    first = position[:1] - period * np.nan_to_num(velocity[:1])
    return np.concatenate([first, position[:-1]]).astype(np.float32)
