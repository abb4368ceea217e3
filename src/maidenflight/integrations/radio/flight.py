"""One flight: up, the reference, perhaps a policy, and down again, whatever happens.

The drone flies by position set-points all the time, never by the firmware's high-level
commander: that one flies on when the link is lost, while set-points that no longer come make the
firmware level the drone after 0.5 s and stop its motors after 2 s.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

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
from maidenflight.integrations.radio.crazyflie import Crazyflie
from maidenflight.integrations.radio.row_files import RowFile
from maidenflight.integrations.radio.watch import (
    FlightStatus,
    Limits,
    Motion,
    Trip,
    Vector,
    Watch,
)

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
    def __init__(self, reason: str, cut: bool = False) -> None:
        self.trip = Trip(reason, cut)


def fly(
    drone: Crazyflie,
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
    flight = _Flight(drone, plan, limits, clock, rows, stops, say)
    ending = Trip("this program failed", cut=False)
    try:
        flight.arm()
        flight.lead()
        ending = Trip(COMPLETE, cut=False)
    except _BrokenOff as broken:
        ending = broken.trip
        say(f"{'stopping the motors' if ending.cut else 'landing'}: {ending.reason}")
    except KeyboardInterrupt:
        ending = Trip("stopped by hand", cut=False)
    finally:
        # Also after an error of this program: nothing else would bring the drone down.
        try:
            cut = ending.cut or flight.land()
        finally:
            flight.stop()
    return Ending(ending.reason, cut, drone.latest.position[2] if drone.latest else float("nan"))


@dataclass(frozen=True)
class _Flight:
    """The stages of a flight; see `fly` for the fields."""

    drone: Crazyflie
    plan: Plan
    limits: Limits
    clock: Clock
    rows: RowFile
    stops: Callable[[], int]
    say: Callable[[str], None]

    def arm(self) -> None:
        """Arms the firmware."""
        drone, until = self.drone, self.clock.now() + ARMING
        while True:
            if self.stops():
                raise _BrokenOff("stopped by hand", cut=True)
            state = drone.latest.supervisor if drone.latest else 0
            if state & (ARMED | AUTO_ARMED) and state & CAN_FLY:
                self.say("armed")
                return
            if drone.lost or self.clock.now() > until:
                reason = "the firmware does not arm; its console (cfclient) says why"
                raise _BrokenOff(drone.lost or reason, cut=True)
            drone.arm(True)
            self.clock.sleep(0.1)

    def lead(self) -> None:
        """Flies from the ground through the plan, until its end or a guard's trip."""
        drone, plan, clock, watch = self.drone, self.plan, self.clock, Watch(self.limits)
        assert drone.latest is not None
        ground = drone.latest.position
        reference = plan.reference + np.array([ground[0], ground[1], 0.0])

        def step(position: Vector, yaw: float = 0.0, motion: Motion | None = None) -> Reading:
            drone.go_to(position, yaw, motion)
            clock.sleep(PERIOD)
            assert drone.latest is not None
            broken = str(self.rows.error.strerror) if self.rows.error else ""
            status = FlightStatus(
                clock.now(), drone.latest, position, ground, drone.lost, broken, self.stops()
            )
            if trip := watch.trip(status):
                raise _BrokenOff(*trip)
            return drone.latest

        def along(
            places: Callable[[float], Vector | None],
            turned: Callable[[float], float] = lambda seconds: 0.0,
            moving: Callable[[float], Motion | None] = lambda seconds: None,
        ) -> None:
            began = clock.now()
            while (position := places(seconds := clock.now() - began)) is not None:
                step(position, turned(seconds), moving(seconds))

        start = _vector(reference[0])
        above = (ground[0], ground[1], start[2])
        self.say(f"taking off to {start[2]:.1f} m")
        along(_straight(ground, above, CLIMB))
        along(_straight(above, start, APPROACH))
        began = resting = clock.now()
        while clock.now() - resting < HOVER:
            reading = step(start)
            there = np.linalg.norm(np.subtract(reading.position, start)) < NEAR
            there &= np.linalg.norm(reading.velocity) < SLOW
            resting = resting if there else clock.now()
            if clock.now() - began > LONGEST_APPROACH:
                raise _BrokenOff(f"no rest at the reference's start in {LONGEST_APPROACH:g} s")
        pilot = "the policy" if plan.policy else "the PID"
        self.say(f"flying for {len(reference) * PERIOD:g} s, {pilot}")
        if plan.policy:
            self._prepare_policy(start, step)
            drone.set(ENABLE, 1)
            along(self._policy_places(reference), moving=self._motions(reference))
            drone.set(ENABLE, 0)
        else:
            along(
                lambda seconds: _entry(reference, seconds), lambda seconds: _yaw(plan.yaw, seconds)
            )
        last = _vector(reference[-1])
        along(lambda seconds: last if seconds < HOVER else None)
        self.say("landing")

    def _prepare_policy(self, start: Vector, step: Callable[[Vector], Reading]) -> None:
        """Sets the parameters of the policy on board, hovering until they have come back."""
        drone, plan, clock = self.drone, self.plan, self.clock
        values = {**plan.on_board, TASK: COMMANDER, START_X: start[0], START_Y: start[1]}
        if plan.full_scale_counts is not None:
            values[FULL] = plan.full_scale_counts
        drone.confirm(values)
        began, tries = clock.now(), 0
        while missing := drone.unconfirmed(values):
            if clock.now() - began > ECHO:
                raise _BrokenOff(f"the drone does not confirm {', '.join(missing[:3])}")
            step(start)
            tries += 1
            if tries % AGAIN == 0:
                drone.confirm({name: values[name] for name in missing})

    def _policy_places(self, reference: np.ndarray) -> Callable[[float], Vector | None]:
        """Set-points of the policy on board by time, as long as it flies."""

        def position_at(seconds: float) -> Vector | None:
            estimate = self.drone.latest
            assert estimate is not None
            # Old rows tell nothing of the policy; other guards judge their age.
            fresh = not self.drone.lost and self.clock.now() - estimate.received < FRESH
            if seconds > HANDOVER and fresh and not estimate.policy:
                raise _BrokenOff(f"the controller on board handed back to the PID ({estimate.why})")
            return _entry(reference, seconds)

        return position_at

    def _motions(self, reference: np.ndarray) -> Callable[[float], Motion | None]:
        """Velocity and acceleration by time, for a policy on board that looks ahead; else none."""
        if not self.drone.has_look_ahead or len(reference) < 2:
            return lambda seconds: None
        velocity = np.gradient(reference, PERIOD, axis=0)
        acceleration = np.gradient(velocity, PERIOD, axis=0)

        def motion(seconds: float) -> Motion:
            return _vector(_nearest(velocity, seconds)), _vector(_nearest(acceleration, seconds))

        return motion

    def land(self) -> bool:
        """Goes down where the drone is, by the last sound estimate.

        Without rows, blindly, as long as it takes from the ceiling.

        Returns:
            Whether the motors stop in the air.
        """
        drone, clock, sound = self.drone, self.clock, self.drone.latest
        if sound is None:
            return True
        x, y, height = sound.position
        watch, began, stop_count = Watch(self.limits), clock.now(), self.stops()
        top = min(height, self.limits.ceiling)
        while clock.now() - began < (top + UNDER) / CLIMB + LAGGING:
            if drone.lost:
                return (drone.latest or sound).position[2] > TOUCHED
            if self.plan.policy:
                drone.set(ENABLE, 0)
            target = max(top - CLIMB * (clock.now() - began), -UNDER)
            drone.go_to((x, y, target))
            clock.sleep(PERIOD)
            now, time = drone.latest or sound, clock.now()
            stops = 2 if self.stops() > max(stop_count, 1) else 0
            trip = watch.trip(FlightStatus(time, now, now.position, now.position, "", "", stops))
            if trip and trip.cut:
                return now.position[2] > TOUCHED
            fresh = time - now.received < self.limits.silence
            if fresh and now.position[2] < TOUCHED and target < TOUCHED:
                break
        return False

    def stop(self) -> None:
        """Stops the motors, again and again: one packet may be lost."""
        until = self.clock.now() + STOPPING
        while self.clock.now() < until and not self.drone.lost:
            self.drone.stop()
            self.clock.sleep(PERIOD)


def _vector(values: np.ndarray) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _entry(reference: np.ndarray, seconds: float) -> Vector | None:
    number = int(seconds / PERIOD + 0.5)
    return _vector(reference[number]) if number < len(reference) else None


def _yaw(yaw: np.ndarray | None, seconds: float) -> float:
    return 0.0 if yaw is None else float(_nearest(yaw, seconds))


def _nearest(rows: np.ndarray, seconds: float) -> np.ndarray:
    return rows[min(int(seconds / PERIOD + 0.5), len(rows) - 1)]


def _straight(start: Vector, end: Vector, speed: float) -> Callable[[float], Vector | None]:
    distance = float(np.linalg.norm(np.subtract(end, start)))

    def position_at(seconds: float) -> Vector | None:
        share = seconds * speed / distance if distance > 1e-6 else 1.0
        return _vector(np.add(start, share * np.subtract(end, start))) if share < 1 else None

    return position_at
