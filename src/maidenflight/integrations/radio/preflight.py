"""What must hold before a flight: a table of findings, each with what to do where it is wrong."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from maidenflight.integrations.radio.blocks import (
    ARMED,
    AUTO_ARMED,
    CAN_BE_ARMED,
    CAN_FLY,
    CHARGING,
    ENABLE,
    FAULTS,
    LIMITS,
    PROPELLER_TEST,
    TESTED,
    Reading,
)
from maidenflight.integrations.radio.clock import Clock
from maidenflight.integrations.radio.crazyflie import Crazyflie
from maidenflight.integrations.radio.watch import Limits, Vector

SETTLING = 10.0
"""Longest wait for the estimator [s]."""
RESET = 0.1
"""How long the estimator stays at its start [s]. Source: cflib 0.1.34,
utils/reset_estimator.py."""
SPINNING = 8.0
"""Longest wait for the propeller test [s]; four motors take 1 s each."""
FEWEST_ROWS = 0.8
"""Share of the rows that must come."""
_AGAIN = "switch the drone off and on"


class Expected(NamedTuple):
    """What must be on board where a policy shall fly."""

    limits: Mapping[str, float] = LIMITS
    """Of the app, by parameter."""
    code: str = ""
    """First 8 hexadecimal digits of the policy's SHA-256; empty where any policy may fly."""
    propellers: str = ""
    """Of the policy's drone, a name of `names.PROPELLERS`; empty where unknown."""


@dataclass(frozen=True)
class PreflightState:
    """What is known of a drone on the ground."""

    reading: Reading
    decks: tuple[str, ...] = ()
    """Of `DECKS`, those that are mounted."""
    variance: Sequence[Vector] = ()
    """Of the estimated position [m2], some time's readings."""
    policy: bool = False
    """Whether a controller on board with our parameters answers."""
    identity: Mapping[str, str] = field(default_factory=dict)
    """See `Crazyflie.identity`."""
    link: float = 1.0
    """Share of the rows that came."""
    charge: int = 0
    """State of the charger."""
    propellers_passed: int | None = None
    """Bits of the propeller test; None where it was not made."""
    unconfirmed: Sequence[str] = ()
    """Parameters that the drone did not confirm."""


class Finding(NamedTuple):
    """A row of the table."""

    name: str
    value: str
    problem: str = ""
    """Why the drone must not take off, and what to do; empty where it may."""

    def __str__(self) -> str:
        """Returns the row as text."""
        return f"{self.name:12} {self.value:28} {self.problem or 'ok'}"


def findings(
    standing: PreflightState, limits: Limits, expected: Expected | None = None
) -> list[Finding]:
    """Returns the table.

    Args:
        standing: the drone on the ground.
        limits: of the ground.
        expected: what must be on board; None where the firmware's PID flies.
    """
    reading, identity = standing.reading, standing.identity
    is_weak, is_empty = standing.link < FEWEST_ROWS, reading.battery < limits.full
    weak = f"only {standing.link:.0%} of rows come; go nearer or choose another channel"
    empty = f"battery at {reading.battery:.2f} V, {limits.full:g} V are needed; charge it"
    charging, decks = CHARGING.get(standing.charge, ""), ", ".join(standing.decks)
    unplug = f"it is {charging}; unplug it" if charging else ""
    no_deck = f"no deck that measures the position; mount a Flow deck v2 and {_AGAIN}"
    return [
        Finding("drone", identity.get("drone", "") or "unknown"),
        Finding("firmware", identity.get("firmware", "") or "unknown"),
        *_policy_findings(standing, expected),
        Finding("link", f"{standing.link:.0%} of rows", weak if is_weak else ""),
        Finding("battery", f"{reading.battery:.2f} V", empty if is_empty else ""),
        Finding("charger", charging or "not connected", unplug),
        Finding("decks", decks or "none", "" if decks else no_deck),
        _propellers(standing.propellers_passed),
        Finding(
            "estimate", "finite" if reading.finite else "no number", _estimate(standing, limits)
        ),
        *_firmware_findings(reading),
    ]


def _policy_findings(standing: PreflightState, expected: Expected | None) -> list[Finding]:
    """What concerns the policy on board."""
    problems = []
    if standing.reading.policy:
        problems.append(f"the policy on board is on and does not obey {ENABLE} = 0; {_AGAIN}")
    if expected is not None and not standing.policy:
        problems.append("no policy on board; build the exported app and flash it")
    elif expected is not None:
        code, propellers = standing.identity.get("on_board"), standing.identity.get("propellers")
        if not code:
            problems.append("the app on board has no mf.hash; export and flash it anew")
        elif expected.code and code != expected.code:
            problems.append(
                f"policy {code} is on board, not {expected.code}; export that file and flash it"
            )
        if expected.propellers and propellers and propellers != expected.propellers:
            problems.append(
                f"the app was built for propellers {propellers}, the policy was identified with "
                f"{expected.propellers}; export it with these"
            )
        if standing.unconfirmed:
            problems.append(
                f"the drone does not confirm {', '.join(standing.unconfirmed[:3])}; go nearer, or "
                "flash an app of this version"
            )
    value = (standing.identity.get("on_board") or "unknown") if standing.policy else "none"
    return [Finding("policy", value, "; ".join(problems))]


def _propellers(passed: int | None) -> Finding:
    """What the firmware's test of propellers found."""
    if passed is None:
        return Finding("propellers", "not tested")
    if not passed & TESTED:
        return Finding("propellers", "no result", f"the propeller test did not end; {_AGAIN}")
    failed = [f"M{motor + 1}" for motor in range(4) if not passed >> motor & 1]
    if not failed:
        return Finding("propellers", "balanced")
    cure = f"the propeller test failed on {', '.join(failed)}; clean, straighten or replace it"
    return Finding("propellers", "unbalanced", cure)


def _estimate(standing: PreflightState, limits: Limits) -> str:
    """Why the estimate is not to be trusted."""
    tilt = np.degrees(standing.reading.tilt)
    if not standing.reading.finite:
        return f"the estimate is not a number; {_AGAIN}"
    if tilt > limits.level:
        return f"tilted by {tilt:.0f} deg; put it level and switch it off and on"
    if not settled(standing.variance):
        return (
            "the estimator does not settle; put the drone onto a well-lit floor with a pattern and "
            "leave it alone"
        )
    return ""


def _firmware_findings(reading: Reading) -> list[Finding]:
    """What the firmware's supervisor says."""
    against = [
        f"the firmware says that it has {state}; put it level, switch it off and on"
        for bit, state in reversed(FAULTS.items())
        if reading.supervisor & bit
    ]
    if not reading.supervisor & (CAN_BE_ARMED | ARMED | AUTO_ARMED | CAN_FLY):
        against.append("the firmware refuses to be armed; its console (cfclient) says why")
    return [Finding("supervisor", f"{reading.supervisor:#x}", "; ".join(against))]


def settled(variance: Sequence[Vector], change: float = 0.001, fewest: int = 10) -> bool:
    """Returns whether the estimator's variance has come to rest.

    Source: cflib 0.1.34, utils/reset_estimator.py.
    """
    last = np.array(variance[-fewest:])
    if len(last) < fewest or not np.isfinite(last).all():
        return False
    return float(np.ptp(last, axis=0).max()) < change


def examine(
    drone: Crazyflie,
    limits: Limits,
    clock: Clock,
    stops: Callable[[], int],
    expected: Expected | None = None,
    test_propellers: bool = False,
) -> list[Finding]:
    """Sets the limits, tests propellers, waits until the estimator settles; returns the table.

    Args:
        drone: connected, on the ground.
        limits: of the ground.
        clock: the program's.
        stops: number of requests to stop.
        expected: see `findings`.
        test_propellers: whether each motor is spun a moment.
    """
    if drone.has_policy:
        # A program that was killed may have left it on: then the policy would take off.
        drone.set(ENABLE, 0)

    def wait(seconds: float, done: Callable[[], bool]) -> None:
        until = clock.now() + seconds
        while not done() and clock.now() < until and not drone.lost and not stops():
            clock.sleep(0.05)

    passed = None
    if test_propellers and drone.parameter(PROPELLER_TEST) is not None:
        drone.set(PROPELLER_TEST, 1)
        wait(1.0, lambda: not drone.propellers_passed & TESTED)
        wait(SPINNING, lambda: bool(drone.propellers_passed & TESTED))
        passed = drone.propellers_passed
    drone.set("kalman.resetEstimation", 1)
    clock.sleep(RESET)
    drone.set("kalman.resetEstimation", 0)
    bounds = expected.limits if expected is not None and drone.has_policy else {}
    drone.confirm(bounds)
    drone.variance.clear()
    drone.count_rows()
    wait(SETTLING, lambda: settled(drone.variance) and not drone.unconfirmed(bounds))
    if drone.lost or drone.latest is None:
        down = f"the link is down ({drone.lost or 'no rows'}); connect again"
        return [Finding("link", "down", down)]
    standing = PreflightState(
        reading=drone.latest,
        decks=drone.decks,
        variance=tuple(drone.variance),
        policy=drone.has_policy,
        identity=drone.identity,
        link=drone.link_quality,
        charge=drone.charge,
        propellers_passed=passed,
        unconfirmed=drone.unconfirmed(bounds),
    )
    return findings(standing, limits, expected)
