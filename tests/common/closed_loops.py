"""Flights of a closed loop whose lag and latency are planted."""

import numpy as np
from scipy.signal import butter, lfilter

from maidenflight.flights.log import Flight, flight_of
from maidenflight.parameters import crazyflie, levers

PERIOD, LATENCY, HOVER = 0.002, 0.002, 0.5
TURN = np.sign(levers(crazyflie())[:, :2])
"""Which way each rotor turns the drone about x and y."""


def _low_pass(order: int, cutoff: float) -> np.ndarray:
    return np.array(butter(order, cutoff, fs=1 / PERIOD))


def _filtered(weights: np.ndarray, noise: np.ndarray) -> np.ndarray:
    return np.asarray(lfilter(weights[0], weights[1], noise, axis=0))


def flown(
    seed: int,
    lag: float = 0.05,
    *,
    seconds: float = 8.0,
    noise: float = 0.03,
    asked: float = 0.3,
    name: str = "flown",
    rotor_speed: bool = False,
    latency: float = LATENCY,
    answer: float = 0.05,
) -> Flight:
    """Roll and pitch of a drone that a controller of rate and attitude holds at 500 Hz.

    Set-points of the attitude [rad] are slow, with a tenth of jitter as from an estimated position.
    Torques of the air are fast, and the gyro's noise [rad/s] goes through its filter of 80 Hz into
    most of the commands, as a real one's does.
    """
    random, rows = np.random.default_rng(seed), round(seconds / PERIOD)
    late, kept = round(latency / PERIOD), np.exp(-PERIOD / lag)
    slow = _filtered(_low_pass(2, 1.0), random.normal(size=(rows, 2)))
    jitter = _filtered(_low_pass(1, 10.0), random.normal(size=(rows, 2)))
    wanted = asked * slow / slow.std(axis=0) + 0.1 * asked * jitter / jitter.std(axis=0)
    air = _filtered(np.array([[0.1, 0.0], [1.0, -0.9]]), 20 * random.normal(size=(rows, 2)))
    heard = random.normal(size=(rows, 2)) * noise * 2
    first, second = _low_pass(2, 80.0)
    delay = np.zeros((2, 2))
    rate, angle, speed = np.zeros(2), np.zeros(2), np.full(4, np.sqrt(HOVER))
    command, gyro, speeds = np.zeros((rows, 4)), np.zeros((rows, 2)), np.zeros((rows, 4))
    for row in range(rows):
        raw = rate + heard[row]
        gyro[row] = first[0] * raw + delay[0]
        delay[0] = first[1] * raw - second[1] * gyro[row] + delay[1]
        delay[1] = first[2] * raw - second[2] * gyro[row]
        torque = answer * ((wanted[row] - angle) * 5 - gyro[row])
        command[row] = np.clip(HOVER + TURN @ torque / 4, 0.02, 1.0)
        speeds[row] = speed
        before = speed
        speed = kept * speed + (1 - kept) * np.sqrt(command[max(row - late, 0)])
        rate = rate + PERIOD * (200 * TURN.T @ ((before**2 + speed**2) / 2) / 1 + air[row])
        angle = angle + PERIOD * rate
    rates = np.concatenate([gyro, np.zeros((rows, 1))], axis=1)
    zeros = np.zeros((rows, 3))
    return flight_of(
        name,
        PERIOD,
        position=zeros,
        velocity=zeros,
        attitude=zeros,
        body_rates=rates,
        command=command,
        zero_order_hold=True,
        accelerometer=np.broadcast_to([0.0, 0.0, 9.81], (rows, 3)),
        rotor_speed=2000 * speeds + random.normal(size=(rows, 4)) if rotor_speed else None,
    )
