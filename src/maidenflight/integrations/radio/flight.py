"""One flight: up, the reference, perhaps a policy, and down again, whatever happens.

The drone flies by position set-points all the time, never by the firmware's high-level
commander: that one flies on when the link is lost, while set-points that no longer come make the
firmware level the drone after 0.5 s and stop its motors after 2 s.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Float

from maidenflight.integrations.radio.blocks import (
    ARMED,
    AUTO_ARMED,
    CAN_FLY,
    COMMANDER,
    ENABLE,
    FULL,
    PERIOD,
    START_X,
    START_Y,
    TASK,
    Reading,
)
from maidenflight.integrations.radio.clock import Clock
from maidenflight.integrations.radio.row_files import RowFile
from maidenflight.integrations.radio.watch import FlightStatus, Limits, Trip, Vector, Watch

CLIMB = 0.4
"""Speed of take-off and landing [m/s]."""
APPROACH = 0.3
"""Speed at which the drone is led to the reference's start [m/s]."""
HOVER = 1.0
"""Time at rest before the reference, and stays after it [s]."""
NEAR, SLOW = 0.1, 0.15
"""Distance [m] and speed [m/s] that count as being there and at rest."""
ECHO, AGAIN = 1.0, 20
"""Longest wait for parameters to come back [s], and set-points after which they are sent again."""
HANDOVER = 0.3
"""Time that the policy on board has to take over [s]."""
FRESH = 0.1
"""Age up to which a row tells what the policy on board does [s]."""
LONGEST_APPROACH = 8.0
"""Time after which a drone that does not come to rest is landed [s]."""
ARMING = 2.0
"""Longest wait for the firmware to be armed [s]."""
TOUCHED = 0.04
"""Height [m] that counts as the ground."""
UNDER = 0.1
"""How far below the ground a landing aims [m], so that the drone touches it."""
LAGGING = 1.0
"""By how much the drone may come down later than commanded [s]."""
STOPPING = 0.5
"""Time over which the motors receive stop commands [s]."""
PROMISED = 7.0
"""Time from the cause of an ending to motors off [s], with the link up; see docs/real-drones.md."""
FIRMWARE_STOPS = 2.0
"""Time without set-points after which the firmware stops the motors [s]. Source: firmware 2026.08,
commander.h."""


class Drone(Protocol):
    """What a flight needs of a connection."""

    lost: str
    latest: Reading | None

    def go_to(self, place: Vector, yaw: float = 0.0) -> None:
        """Asks for a position [m]."""
        ...

    def set(self, name: str, value: float) -> None:
        """Sets a parameter."""
        ...

    def confirm(self, values: Mapping[str, float]) -> None:
        """Sets parameters and asks for them."""
        ...

    def unconfirmed(self, values: Mapping[str, float]) -> list[str]:
        """Lists those that have not come back as they were set."""
        ...

    def arm(self, armed: bool) -> None:
        """Arms or disarms."""
        ...

    def stop(self) -> None:
        """Stops the motors."""
        ...


@dataclass(frozen=True)
class Plan:
    """What to fly."""

    reference: Float[np.ndarray, "N 3"]
    """Set-points, one each 10 ms [m]; x and y from the place of take-off."""
    policy: bool = False
    """Whether the policy on board flies it, else the firmware's PID."""
    full_scale_counts: float | None = None
    """Counts of a thrust command of 1, if not those of the policy's own interface, which the app
    has from its export."""
    yaw: Float[np.ndarray, "N"] | None = None
    """Yaw, one each 10 ms [rad]; zero by default. The policy on board has none."""
    on_board: Mapping[str, float] = field(default_factory=dict)
    """Limits of the policy on board, by parameter, which are set and read back before it flies."""


class Ending(NamedTuple):
    """How a flight ended."""

    reason: str
    """Why; `complete` where it flew to its end."""
    cut: bool
    """Whether motors were stopped in the air."""
    height: float
    """Last known [m]."""


COMPLETE = "complete"


class _BrokenOff(Exception):
    def __init__(self, trip: Trip) -> None:
        self.trip = trip


def fly(
    drone: Drone,
    plan: Plan,
    limits: Limits,
    clock: Clock,
    rows: RowFile,
    stops: Callable[[], int],
    say: Callable[[str], None],
) -> Ending:
    """Flies a plan and comes down.

    Returns when the motors have been stopped or nothing can be done any more.

    An error of this program lands the drone too; one in the landing itself stops the motors.

    Args:
        drone: connected, on the ground, fit to fly.
        plan: what to fly.
        limits: where to break off.
        clock: the program's.
        rows: where rows go; only its health is read.
        stops: number of requests to stop: once lands, twice stops the motors.
        say: called with messages.
    """
    watch = Watch(limits)
    ending = Trip("this program failed", cut=False)
    try:
        _arm(drone, clock, stops, say)
        _lead(drone, plan, watch, clock, rows, stops, say)
        ending = Trip(COMPLETE, cut=False)
    except _BrokenOff as broken:
        ending = broken.trip
        say(f"{'stopping the motors' if ending.cut else 'landing'}: {ending.reason}")
    except KeyboardInterrupt:
        ending = Trip("stopped by hand", cut=False)
    finally:
        # Also after an error of this program: nothing else would bring the drone down.
        try:
            cut = ending.cut or _land(drone, plan, limits, clock, stops)
        finally:
            _stop(drone, clock)
    return Ending(ending.reason, cut, drone.latest.position[2] if drone.latest else float("nan"))


def _arm(drone: Drone, clock: Clock, stops: Callable[[], int], say: Callable[[str], None]) -> None:
    until = clock.now() + ARMING
    while True:
        if stops():
            raise _BrokenOff(Trip("stopped by hand", cut=True))
        if (
            drone.latest
            and drone.latest.supervisor & (ARMED | AUTO_ARMED)
            and drone.latest.supervisor & CAN_FLY
        ):
            say("armed")
            return
        if drone.lost or clock.now() > until:
            raise _BrokenOff(
                Trip(
                    drone.lost or "the firmware does not arm; its console (cfclient) says why",
                    cut=True,
                )
            )
        drone.arm(True)
        clock.sleep(0.1)


def _lead(
    drone: Drone,
    plan: Plan,
    watch: Watch,
    clock: Clock,
    rows: RowFile,
    stops: Callable[[], int],
    say: Callable[[str], None],
) -> None:
    """From the ground through the plan, until its end or a guard's trip."""
    assert drone.latest is not None
    ground = drone.latest.position
    reference = plan.reference + np.array([ground[0], ground[1], 0.0])

    def step(place: Vector, yaw: float = 0.0) -> Reading:
        drone.go_to(place, yaw)
        clock.sleep(PERIOD)
        assert drone.latest is not None
        broken = str(rows.error.strerror) if rows.error else ""
        trip = watch.trip(
            FlightStatus(clock.now(), drone.latest, place, ground, drone.lost, broken, stops())
        )
        if trip:
            raise _BrokenOff(trip)
        return drone.latest

    def along(
        places: Callable[[float], Vector | None],
        turned: Callable[[float], float] = lambda seconds: 0.0,
    ) -> None:
        began = clock.now()
        while (place := places(seconds := clock.now() - began)) is not None:
            step(place, turned(seconds))

    start = _vector(reference[0])
    above = (ground[0], ground[1], start[2])
    say(f"taking off to {start[2]:.1f} m")
    along(_straight(ground, above, CLIMB))
    along(_straight(above, start, APPROACH))
    began = resting = clock.now()
    while clock.now() - resting < HOVER:
        reading = step(start)
        there = (
            np.linalg.norm(np.subtract(reading.position, start)) < NEAR
            and np.linalg.norm(reading.velocity) < SLOW
        )
        resting = resting if there else clock.now()
        if clock.now() - began > LONGEST_APPROACH:
            raise _BrokenOff(
                Trip(f"no rest at the reference's start in {LONGEST_APPROACH:g} s", cut=False)
            )
    say(f"flying for {len(reference) * PERIOD:g} s, {'the policy' if plan.policy else 'the PID'}")
    if plan.policy:
        counts = () if plan.full_scale_counts is None else ((FULL, plan.full_scale_counts),)
        start_values = ((TASK, COMMANDER), (START_X, start[0]), (START_Y, start[1]))
        values = {**plan.on_board, **dict((*start_values, *counts))}
        drone.confirm(values)
        began, tries = clock.now(), 0
        while missing := drone.unconfirmed(values):
            if clock.now() - began > ECHO:
                reason = f"the drone does not confirm {', '.join(missing[:3])}"
                raise _BrokenOff(Trip(reason, cut=False))
            step(start)
            tries += 1
            if tries % AGAIN == 0:
                drone.confirm({name: values[name] for name in missing})
        drone.set(ENABLE, 1)
        began = clock.now()

        def place(seconds: float) -> Vector | None:
            estimate = drone.latest
            assert estimate is not None
            # Old rows tell nothing of the policy; other guards judge their age.
            fresh = not drone.lost and clock.now() - estimate.received < FRESH
            if seconds > HANDOVER and fresh and not estimate.policy:
                raise _BrokenOff(
                    Trip(
                        f"the controller on board handed back to the PID ({estimate.why})",
                        cut=False,
                    )
                )
            return _entry(reference, seconds)

        along(place)
        drone.set(ENABLE, 0)
    else:
        along(lambda seconds: _entry(reference, seconds), lambda seconds: _yaw(plan.yaw, seconds))
    last = _vector(reference[-1])
    along(lambda seconds: last if seconds < HOVER else None)
    say("landing")


def _vector(values: np.ndarray) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _entry(reference: np.ndarray, seconds: float) -> Vector | None:
    number = int(seconds / PERIOD + 0.5)
    return _vector(reference[number]) if number < len(reference) else None


def _yaw(yaw: np.ndarray | None, seconds: float) -> float:
    return 0.0 if yaw is None else float(yaw[min(int(seconds / PERIOD + 0.5), len(yaw) - 1)])


def _straight(start: Vector, end: Vector, speed: float) -> Callable[[float], Vector | None]:
    distance = float(np.linalg.norm(np.subtract(end, start)))

    def place(seconds: float) -> Vector | None:
        share = seconds * speed / distance if distance > 1e-6 else 1.0
        return _vector(np.add(start, share * np.subtract(end, start))) if share < 1 else None

    return place


def _land(drone: Drone, plan: Plan, limits: Limits, clock: Clock, stops: Callable[[], int]) -> bool:
    """Goes down where the drone is, by the last sound estimate.

    Without rows, blindly, as long as it takes from the ceiling.

    Returns:
        Whether the motors stop in the air.
    """
    sound = drone.latest
    if sound is None:
        return True
    x, y, height = sound.position
    watch, began, stop_count = Watch(limits), clock.now(), stops()
    top = min(height, limits.ceiling)
    while clock.now() - began < (top + UNDER) / CLIMB + LAGGING:
        if drone.lost:
            return (drone.latest or sound).position[2] > TOUCHED
        if plan.policy:
            drone.set(ENABLE, 0)
        target = max(top - CLIMB * (clock.now() - began), -UNDER)
        drone.go_to((x, y, target))
        clock.sleep(PERIOD)
        now = drone.latest or sound
        status = FlightStatus(
            clock.now(),
            now,
            now.position,
            now.position,
            "",
            "",
            2 if stops() > max(stop_count, 1) else 0,
        )
        trip = watch.trip(status)
        if trip and trip.cut:
            return now.position[2] > TOUCHED
        fresh = status.now - now.received < limits.silence
        if fresh and now.position[2] < TOUCHED and target < TOUCHED:
            break
    return False


def _stop(drone: Drone, clock: Clock) -> None:
    """Stops the motors, again and again: one packet may be lost."""
    until = clock.now() + STOPPING
    while clock.now() < until and not drone.lost:
        drone.stop()
        clock.sleep(PERIOD)
