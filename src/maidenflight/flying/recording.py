"""`record`: logs of the firmware's controllers in a reality, excited so that motors show."""

from collections.abc import Sequence
from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Array, Int

from maidenflight import inputs
from maidenflight.errors import InputError
from maidenflight.flights.flight_plan import FlightPlan
from maidenflight.flights.log import Flight, thinned
from maidenflight.flights.manoeuvres import RATE as PLAN_RATE
from maidenflight.flying.engine import fly_all
from maidenflight.flying.firmware_pilot import CONTROLLERS, RATE, FirmwarePilot, planned
from maidenflight.flying.rows import SimulatedFlight
from maidenflight.flying.scenario import Scenario
from maidenflight.simulator.controllers.pid import generation_of as generation
from maidenflight.simulator.physics import sensors
from maidenflight.simulator.realities.reality import AnyReality, check_reality
from maidenflight.simulator.tasks import tasks


def record(
    reality: AnyReality | str,
    key: Array | int = 0,
    flights: int = 4,
    duration: float = 30.0,
    excitation: float = 0.06,
    rate: int = RATE,
    firmware: str = "2021.10",
    controller: str = "pid",
) -> Sequence[Flight]:
    """Lets a controller of the firmware fly the paper's circle in a reality and logs it.

    Virtual drones have an accelerometer where rows are close enough for one. A reality that takes
    positions flies its own controller instead, at 100 Hz. `engine.fly_all` flies other tasks.

    Args:
        reality: the drone or simulator, or its name.
        key: random key, or a whole number that makes one.
        flights: how many.
        duration: of each [s].
        excitation: share of full thrust by which motors are excited [-]; 0 is the plain PID.
        rate: rows a second [Hz], a divisor of 500. Below 500 the log is subsampled.
        firmware: `"2021.10"`, as the paper's flights had, or `"2026.08"`: its PID, its battery
            compensation, and u = 1 is full PWM in its logs.
        controller: a key of `CONTROLLERS`.

    Raises:
        InputError: another controller or rate, a reality that takes neither motor commands nor
            positions, one that takes positions and an excitation above 0, or a drone that the PID
            cannot hold.
    """
    if controller not in CONTROLLERS:
        raise InputError(f"controller = {controller!r}; expected one of {', '.join(CONTROLLERS)}.")
    pilot = FirmwarePilot(
        np.float32(excitation), firmware=generation(firmware), controller=controller
    )
    must_divide(rate)
    keys = jax.random.split(inputs.random_key(key), flights)
    simulated = fly_all(
        check_reality(reality), pilot, Scenario(tasks.paper_circle(), duration), keys
    )
    return _logs(simulated, keys, rate)


def record_plan(
    reality: AnyReality,
    plan: FlightPlan,
    key: Array,
    flights: int = 1,
    rate: int = RATE,
    firmware: str = "2021.10",
) -> Sequence[Flight]:
    """Lets the firmware's position PID fly a plan in a reality and logs it.

    Args:
        reality: the drone or simulator; see `record`.
        plan: what to fly.
        key: random key.
        flights: how often.
        rate: rows a second [Hz], a divisor of 500.
        firmware: see `record`.

    Raises:
        InputError: another rate, a reality that cannot fly it, or a drone that the PID cannot hold.
    """
    must_divide(rate)
    keys = jax.random.split(key, flights)
    return _logs(fly_plans(check_reality(reality), [plan] * flights, keys, firmware), keys, rate)


def fly_plans(
    reality: AnyReality, plans: Sequence[FlightPlan], keys: Int[Array, "F"], firmware: str
) -> list[SimulatedFlight]:
    """Flies plans of one length, each with its key.

    Raises:
        InputError: a reality that cannot fly them, or a drone that the PID cannot hold.
    """
    pilots = [planned(plan, firmware) for plan in plans]
    seconds = len(np.asarray(pilots[0].setpoints)) / PLAN_RATE
    return fly_all(reality, pilots, Scenario(tasks.hover(), seconds), keys)


def must_divide(rate: int) -> None:
    """Refuses rates of a log at which rows would not be commands.

    Raises:
        InputError: it is no divisor of `RATE`.
    """
    if rate < 1 or RATE % rate:
        raise InputError(f"rate = {rate} Hz; expected a divisor of {RATE}, such as 500, 250, 100.")


def _logs(simulated: Sequence[SimulatedFlight], keys: Int[Array, "F"], rate: int) -> list[Flight]:
    return [
        flight_log(flight, f"flight_{number:02d}", rate, key)
        for number, (flight, key) in enumerate(zip(simulated, keys, strict=True), 1)
    ]


def flight_log(simulated: SimulatedFlight, name: str, rate: int, key: Array) -> Flight:
    """Returns the log of a flight: every row, or as many as a slower one holds."""
    flight = simulated.to_flight(name)
    if simulated.drone is not None:
        seed = np.asarray(jax.random.bits(jax.random.fold_in(key, RATE), (2,))).tolist()
        force = sensors.accelerometer(
            np.asarray(simulated.rows.true_velocity, np.float64),
            np.asarray(simulated.rows.true_attitude, np.float64),
            flight.period,
            float(simulated.drone.gravity),
            np.random.default_rng(seed),
        )
        # True states are those at the ends of the periods, rows those at their beginnings.
        late = np.concatenate([force[:1], force[:-1]]).astype(np.float32)
        flight = replace(flight, accelerometer=late)
    return flight if rate >= simulated.rate else thinned(flight, simulated.rate // rate)
