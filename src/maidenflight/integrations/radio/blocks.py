"""Log blocks of a Crazyflie: two at 100 Hz, a slow one before take-off, and their units.

A block carries at most 26 bytes. Estimates come as 16-bit integers (`stateEstimateZ`, mm, mm/s and
mrad/s, its `ratePitch` positive nose up), the attitude as a quaternion in float16, whose step is
0.0001 near level against 0.0014 of the compressed one. The body rates are the gyro's, read in the
same tick as the rest of the block.

Source: Crazyflie firmware 2026.08, src/modules/src/stabilizer.c, log.c, supervisor.c; cflib 0.1.34,
crazyflie/log.py.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

PERIOD = 0.01
"""Of both fast blocks [s]; the firmware's shortest."""
BYTES: Mapping[str, int] = {"uint8_t": 1, "int16_t": 2, "uint16_t": 2, "FP16": 2, "float": 4}
"""By type of the firmware's log.c."""


class Block(NamedTuple):
    """Variables that one packet carries."""

    name: str
    variables: Mapping[str, str]
    """Log variable to the type that it is fetched as."""
    period: float = PERIOD
    """[s]."""

    @property
    def size(self) -> int:
        """[bytes]."""
        return sum(BYTES[kind] for kind in self.variables.values())


_XYZ = ("x", "y", "z")
_ESTIMATES = (*_XYZ, "vx", "vy", "vz", "rateRoll", "ratePitch", "rateYaw")
STATE = Block(
    "state",
    {f"stateEstimateZ.{name}": "int16_t" for name in _ESTIMATES}
    | {f"stateEstimate.q{name}": "FP16" for name in (*_XYZ, "w")},
)
MOTORS = Block(
    "motors",
    {f"motor.m{number}": "uint16_t" for number in (1, 2, 3, 4)}
    | {f"ctrltarget.{name}": "FP16" for name in _XYZ}
    | {"controller.cmd_thrust": "FP16", "pm.vbatMV": "uint16_t", "supervisor.info": "uint16_t"},
)
CHARGE, PROPELLERS_PASSED = "pm.state", "health.motorPass"
VARIANCE = Block(
    "variance",
    {f"kalman.varP{name}": "float" for name in ("X", "Y", "Z")}
    | {CHARGE: "uint8_t", PROPELLERS_PASSED: "uint8_t"},
    period=0.1,
)
"""How sure the estimator is of its position [m2], and what else matters before take-off."""
CHARGING = {1: "charging", 2: "charged, on its charger"}
"""By `CHARGE`. Source: firmware 2026.08, pm.h, PMStates."""
PROPELLER_TEST, TESTED = "health.startPropTest", 1 << 7
"""Parameter that spins each motor a moment, and the bit of `PROPELLERS_PASSED` that ends it; the
lower four tell which passed. Source: firmware 2026.08, health.c."""

ENABLE = "mf.enable"
"""Parameter of the controller on board: 1 lets the policy fly, 0 hands back to the firmware's
PID."""
ACTIVE = "mf.active"
"""Log variable of the controller on board: whether the policy flies."""
AHEAD = "mf.ahead"
"""Parameter that the controller on board has where its policy looks ahead: at how many points."""
WHY = "mf.why"
"""Log variable of the controller on board: why it last did not, a number of `REASONS`."""
REASONS = (
    "nothing",
    "switched off",
    "tilt",
    "body rate",
    "distance",
    "not a number",
    "no position set-points",
    "parameters",
    "self-test",
    "another controller was chosen",
    "set-points without a future",
    "battery",
    "fence",
    "ceiling",
    "time",
    "estimate against accelerometer",
    "another drone than the policy's",
)
"""Source: integrations/exporters/crazyflie/src/maidenflight.c.template, enum why."""
TASK, START_X, START_Y, FULL = "mf.task", "mf.x", "mf.y", "mf.full"
"""Parameters of the controller on board: what the policy follows, where that starts [m], and what a
thrust command of 1 is [counts]."""
HASH, PROPELLERS = "mf.hash", "mf.propellers"
"""Parameters of the controller on board: first 32 bits of the policy's SHA-256, and a number of
`names.PROPELLERS`."""
LONGEST = "mf.time"
LIMITS: Mapping[str, float] = {
    "mf.tilt": 30.0,
    "mf.rate": 800.0,
    "mf.distance": 0.6,
    "mf.battery": 2.8,
    "mf.fence": 1.5,
    "mf.ceiling": 1.8,
    LONGEST: 120.0,
    "mf.drift": 0.75,
    "mf.hover": 0.25,
}
"""Of the controller on board, as it is built; a session before may have left others."""
COMMANDER = 2
"""Value of `TASK`: the policy follows the position set-points that come by radio."""


def with_policy(block: Block) -> Block:
    """Returns the block with what the controller on board tells."""
    return block._replace(variables={**block.variables, ACTIVE: "uint8_t", WHY: "uint8_t"})


CAN_BE_ARMED, ARMED, AUTO_ARMED, CAN_FLY, FLYING, TUMBLED, LOCKED, CRASHED = (
    1 << bit for bit in range(8)
)
"""Bits of `supervisor.info`. Source: cflib 0.1.34, crazyflie/supervisor.py."""
FAULTS = {TUMBLED: "tumbled", CRASHED: "crashed", LOCKED: "locked"}
"""Of these, those with which a drone does not fly, by name."""


class Reading(NamedTuple):
    """The last telemetry of a drone, in SI units and our signs."""

    received: float
    """When the last state came [s], on the program's clock."""
    position: tuple[float, float, float]
    """[m]."""
    velocity: tuple[float, float, float]
    """[m/s]."""
    quaternion: tuple[float, float, float, float]
    """Body to world; x, y, z, w."""
    body_rates: tuple[float, float, float]
    """[rad/s]."""
    motors: tuple[float, float, float, float]
    """[counts of 65535]."""
    battery: float
    """[V]."""
    supervisor: int
    """Bits."""
    policy: bool
    """Whether the policy on board flies."""
    why: str
    """Why it last did not, of `REASONS`."""

    @property
    def finite(self) -> bool:
        """Whether every number of the estimate is one."""
        numbers = *self.position, *self.velocity, *self.quaternion, *self.body_rates
        return all(map(math.isfinite, numbers))

    @property
    def tilt(self) -> float:
        """Angle between the body's and the world's upward axis [rad]; NaN if not known."""
        x, y, z, w = self.quaternion
        upright = 1 - 2 * (x * x + y * y) / max(x * x + y * y + z * z + w * w, 1e-9)
        return math.acos(min(max(upright, -1.0), 1.0))


def reading(values: Mapping[str, float], received: float) -> Reading:
    """Returns what the last packets of both fast blocks mean together.

    Args:
        values: log variables in the firmware's units.
        received: when the last state came [s].
    """
    state = [values[f"stateEstimateZ.{name}"] / 1000 for name in _ESTIMATES]
    x, y, z, vx, vy, vz, roll_rate, pitch_rate, yaw_rate = state
    qx, qy, qz, qw = (values[f"stateEstimate.q{name}"] for name in (*_XYZ, "w"))
    m1, m2, m3, m4 = (values[f"motor.m{number}"] for number in (1, 2, 3, 4))
    return Reading(
        received=received,
        position=(x, y, z),
        velocity=(vx, vy, vz),
        quaternion=(qx, qy, qz, qw),
        body_rates=(roll_rate, -pitch_rate, yaw_rate),
        motors=(m1, m2, m3, m4),
        battery=values["pm.vbatMV"] / 1000,
        supervisor=int(values["supervisor.info"]),
        policy=bool(values.get(ACTIVE, 0)),
        why=REASONS[int(values.get(WHY, 0)) % len(REASONS)],
    )
