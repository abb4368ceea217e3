"""A quadrotor and its cascaded controller in plain Python, for the fake drone: fast, and
independent of the simulator under test."""

import math
import random
from dataclasses import dataclass, field

STEP = 0.002
GRAVITY = 9.81
THRUST_TO_WEIGHT = 1.9
MOTOR_TIME_CONSTANT = 0.06
MASS, ARM, DRAG = 0.028, 0.028, 0.00596
INERTIA = (1.33e-5, 1.33e-5, 2.64e-5)
OFF, POSITION, LEVEL = "off", "position", "level"


@dataclass
class Plant:
    """State of the drone, and what its firmware asks for."""

    seed: int = 0
    position: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    velocity: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    quaternion: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0, 1.0])
    rates: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    rotors: list[float] = field(default_factory=lambda: [0.0] * 4)
    command: list[float] = field(default_factory=lambda: [0.0] * 4)
    mode: str = OFF
    setpoint: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    gust: float = 0.0
    dead_motor: int | None = None
    stiffness: float = 1.0
    impact: float = 0.0

    def __post_init__(self):
        self.random = random.Random(self.seed)
        self._lift, self._rate_integral, self._ticks = 0.0, [0.0, 0.0], 0
        self._wanted, self._thrust = [0.0, 0.0], 0.0

    @property
    def attitude(self):
        """Roll, pitch, yaw [rad]; pitch positive nose down."""
        x, y, z, w = self.quaternion
        pitch = math.asin(min(max(2 * (w * y - z * x), -1.0), 1.0))
        return (
            math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
            pitch,
            math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
        )

    @property
    def turning(self):
        """Whether any motor is told to turn."""
        return any(self.command)

    def step(self):
        """One step of `STEP`."""
        self._control()
        forces = []
        for motor in range(4):
            u = 0.0 if motor == self.dead_motor else self.command[motor]
            self.rotors[motor] += (math.sqrt(u) - self.rotors[motor]) * STEP / MOTOR_TIME_CONSTANT
            forces.append(THRUST_TO_WEIGHT * MASS * GRAVITY / 4 * self.rotors[motor] ** 2)
        f1, f2, f3, f4 = forces
        torque = (
            ARM * (-f1 - f2 + f3 + f4),
            ARM * (-f1 + f2 + f3 - f4),
            DRAG * (-f1 + f2 - f3 + f4),
        )
        p, q, r = self.rates
        ix, iy, iz = INERTIA
        turn = (
            (torque[0] - (iz - iy) * q * r) / ix,
            (torque[1] - (ix - iz) * p * r) / iy,
            (torque[2] - (iy - ix) * p * q) / iz,
        )
        self.rates = [
            rate + STEP * (change + self.random.gauss(0, 8.0))
            for rate, change in zip(self.rates, turn, strict=True)
        ]
        x, y, z, w = self.quaternion
        p, q, r = (STEP / 2 * rate for rate in self.rates)
        x, y, z, w = (
            x + w * p + y * r - z * q,
            y + w * q + z * p - x * r,
            z + w * r + x * q - y * p,
            w - x * p - y * q - z * r,
        )
        size = math.sqrt(x * x + y * y + z * z + w * w)
        x, y, z, w = self.quaternion = [x / size, y / size, z / size, w / size]
        lift = sum(forces) / MASS
        push = (
            2 * (x * z + w * y) * lift + self.gust,
            2 * (y * z - w * x) * lift,
            (1 - 2 * (x * x + y * y)) * lift - GRAVITY,
        )
        self.velocity = [
            speed + STEP * gain for speed, gain in zip(self.velocity, push, strict=True)
        ]
        self.position = [
            place + STEP * speed for place, speed in zip(self.position, self.velocity, strict=True)
        ]
        if self.position[2] <= 0.0:
            yaw = self.attitude[2]
            self.impact = max(self.impact, -self.velocity[2])
            self.position[2], self.velocity, self.rates = 0.0, [0.0] * 3, [0.0] * 3
            self.quaternion = [0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)]

    def _control(self):
        self._ticks += 1
        if self.mode == OFF:
            self.command, self._lift, self._rate_integral = [0.0] * 4, 0.0, [0.0, 0.0]
            return
        roll, pitch, yaw = self.attitude
        if self._ticks % 5 == 0:
            self._aim(yaw)
        turn = [
            6 * (self._wanted[0] - roll),
            6 * (self._wanted[1] - pitch),
            3 * math.remainder(self.setpoint[3] - yaw, math.tau),
        ]
        error = [wanted - rate for wanted, rate in zip(turn, self.rates, strict=True)]
        for axis in (0, 1):
            self._rate_integral[axis] = min(
                max(self._rate_integral[axis] + error[axis] * STEP, -0.5), 0.5
            )
        p = 0.06 * self.stiffness * error[0] + 0.1 * self._rate_integral[0]
        q = 0.06 * self.stiffness * error[1] + 0.1 * self._rate_integral[1]
        r, t = 0.05 * error[2], self._thrust
        self.command = [
            min(max(u, 0.0), 1.0)
            for u in (t - p - q - r, t - p + q + r, t + p + q - r, t + p - q + r)
        ]

    def _aim(self, yaw):
        if self.mode == LEVEL:
            self._wanted, self._thrust = [0.0, 0.0], 1 / THRUST_TO_WEIGHT
            return
        speed = [
            min(max(2 * (wanted - place), -1.1), 1.1)
            for wanted, place in zip(self.setpoint[:3], self.position, strict=True)
        ]
        gain = [3.5 * (wanted - now) for wanted, now in zip(speed, self.velocity, strict=True)]
        self._lift = min(max(self._lift + 0.01 * 2 * gain[2], -2.0), 2.0)
        forward, left = (
            gain[0] * math.cos(yaw) + gain[1] * math.sin(yaw),
            gain[1] * math.cos(yaw) - gain[0] * math.sin(yaw),
        )
        self._wanted = [
            min(max(tilt, -0.35), 0.35) for tilt in (-left / GRAVITY, forward / GRAVITY)
        ]
        self._thrust = (GRAVITY + gain[2] + self._lift) / (GRAVITY * THRUST_TO_WEIGHT)
