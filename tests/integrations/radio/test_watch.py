"""What breaks a flight off, when, and how; what a packet means."""

import math

import pytest

from maidenflight.integrations.radio.blocks import (
    ARMED,
    CAN_FLY,
    FLYING,
    MOTORS,
    STATE,
    TUMBLED,
    reading,
)
from maidenflight.integrations.radio.preflight import PreflightState, findings, settled
from maidenflight.integrations.radio.watch import (
    FlightStatus,
    Limits,
    Watch,
)

VALUES = dict.fromkeys((*STATE.variables, *MOTORS.variables), 0.0) | {
    "stateEstimateZ.x": 100.0,
    "stateEstimateZ.vy": -200.0,
    "stateEstimateZ.z": 1000.0,
    "stateEstimateZ.rateRoll": 1000.0,
    "stateEstimateZ.ratePitch": 500.0,
    "stateEstimate.qw": 1.0,
    "motor.m1": 40000.0,
    "pm.vbatMV": 3900.0,
    "supervisor.info": float(ARMED | CAN_FLY | FLYING),
}
HERE = (0.1, 0.0, 1.0)


def seen(now=0.0, setpoint=HERE, lost="", broken="", stops=0, received=None, **values):
    told = reading(
        VALUES | {name.replace("_", ".", 1): value for name, value in values.items()},
        now if received is None else received,
    )
    return FlightStatus(now, told, setpoint, (0.0, 0.0, 0.0), lost, broken, stops)


def test_a_packet_in_our_units_and_signs():
    told = reading(VALUES, 3.0)
    assert told.position == (0.1, 0.0, 1.0)
    assert told.velocity == (0.0, -0.2, 0.0)
    assert told.body_rates == (1.0, -0.5, 0.0)
    assert (told.battery, told.received, told.finite, told.tilt, told.policy) == (
        3.9,
        3.0,
        True,
        0.0,
        False,
    )


@pytest.mark.parametrize("angle", [0.3, 1.5, 3.0])
def test_tilt_is_the_angle_between_the_upward_axes(angle):
    quaternion = {"stateEstimate.qw": math.cos(angle / 2), "stateEstimate.qy": math.sin(angle / 2)}
    assert reading(VALUES | quaternion, 0.0).tilt == pytest.approx(angle)


def test_all_is_well():
    assert Watch(Limits()).trip(seen()) is None


@pytest.mark.parametrize(
    ("now", "patience", "cut", "reason"),
    [
        ({"stops": 1}, 0.0, False, "stopped by hand"),
        ({"stops": 2}, 0.0, True, "stopped at once by hand"),
        ({"lost": "gone"}, 0.0, False, "link lost: gone"),
        ({"broken": "full"}, 0.0, False, "rows cannot be written: full"),
        ({"received": -0.6}, 0.0, False, "no rows for 0.5 s"),
        ({"supervisor_info": TUMBLED | ARMED}, 0.05, True, "tumbled"),
        ({"supervisor_info": 0}, 0.1, True, "disarmed"),
        ({"stateEstimate_qx": math.nan}, 0.1, True, "not a number"),
        ({"stateEstimate_qx": 1.0}, 0.05, True, "tilt of 90 deg"),
        ({"motor_m1": 0}, 0.5, True, "stopped the motors"),
        ({"pm_vbatMV": 2990}, 0.5, False, "battery at 2.99 V"),
        ({"stateEstimateZ_z": 1900}, 0.1, False, "at a height of 1.90 m"),
        (
            {"stateEstimateZ_y": -1600, "setpoint": (0.1, -1.6, 1.0)},
            0.1,
            False,
            "1.60 m from the place of take-off",
        ),
        ({"setpoint": (0.1, 0.0, 1.4)}, 0.5, False, "0.40 m below the set-point"),
        ({"setpoint": (0.1, 0.7, 1.0)}, 0.2, False, "0.70 m from the set-point"),
    ],
)
def test_each_guard_waits_as_long_as_it_may_and_no_longer(now, patience, cut, reason):
    watch = Watch(Limits())
    if patience:
        assert watch.trip(seen(**now)) is None
        # A moment of peace starts its patience anew.
        assert watch.trip(seen(0.9 * patience)) is None
        began = patience
        assert watch.trip(seen(began, **now)) is None
        assert watch.trip(seen(began + 0.9 * patience, **now)) is None
    else:
        began = 0.0
    trip = watch.trip(seen(began + 1.01 * patience, **now))
    assert trip is not None
    assert reason in trip.reason
    assert trip.cut == cut


def test_the_gravest_reason_is_told():
    trip = Watch(Limits()).trip(seen(stops=2, lost="gone"))
    assert trip is not None
    assert trip.cut


def test_a_fit_drone_may_fly():
    still = ((0.01, 0.01, 0.02),) * 10
    fit = PreflightState(seen().reading, ("deck.bcFlow2",), still)
    assert not [one for one in findings(fit, Limits()) if one.problem]
    assert not settled(still[:9])
    assert not settled((*still[:9], (0.01, 0.02, 0.02)))
    assert not settled((*still[:9], (0.01, math.nan, 0.02)))
