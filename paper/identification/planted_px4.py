"""Planted quadrotors like PX4's x500, whose logs hold what PX4's default profile does.

A cascade as PX4's flies each for a minute at 800 Hz: tilt by a pilot, rates, motors by PX4's
allocation, with its filters of the gyro, vibration and gusts. Thrust-to-weight ratio, lag, latency
and inertia are drawn at random, and identified as by `identify LOG --start x500 --mass GRAMS`.
Prints what is found over the truth, and whether 95 % intervals hold it.

    python paper/identification/planted_px4.py --drones 6 -o planted_px4

Source of the controller: PX4 v1.14, src/modules/mc_att_control, mc_rate_control,
lib/control_allocation; of the logged topics: src/modules/logger/logged_topics.cpp.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import polars
from scipy.signal import butter

import maidenflight as mf
from maidenflight import results
from maidenflight.errors import require_packages
from maidenflight.flights.checked_log import check_log
from maidenflight.flights.formats import Logged
from maidenflight.flights.log import Flight
from maidenflight.identification.start import read_start
from maidenflight.integrations.logs import px4, px4_allocation
from maidenflight.integrations.logs.px4_allocation import Rotor

RATE, SECONDS = 800, 60.0
ARM = 0.174
ROTORS = tuple(
    Rotor(ARM * forward, ARM * right, moment=0.016 * turn)
    for forward, right, turn in ((1, 1, 1), (-1, -1, 1), (1, -1, -1), (-1, 1, -1))
)
GRAVITY, MASS = 9.81, 2.0643
INERTIA = np.array([0.0236, 0.0236, 0.0439])
EVERY = {"sensor_combined": 4, "set-points": 16, "actuator_motors": 80, "battery_status": 160}
"""Steps of the controller to a sample of a topic: 200, 50, 10 and 5 Hz."""


class Drone(NamedTuple):
    """What is planted, SI units."""

    thrust_to_weight: float
    motor_time_constant: float
    latency: float
    inertia: np.ndarray


def draw_drone(generator: np.random.Generator) -> Drone:
    """Draws a drone."""
    return Drone(
        generator.uniform(1.6, 2.8),
        generator.uniform(0.015, 0.060),
        generator.integers(2, 6) / RATE,
        INERTIA * generator.uniform(0.7, 1.5, 3),
    )


class Signals(NamedTuple):
    """What a flight was, at `RATE`: forward, right, down."""

    rates: np.ndarray
    force: np.ndarray
    rate_setpoint: np.ndarray
    torque_thrust: np.ndarray
    motors: np.ndarray


class _Filter:
    """Butterworth of second order, sample by sample."""

    def __init__(self, cutoff: float) -> None:
        coefficients: Any = butter(2, cutoff, fs=RATE)
        self.above, self.below = coefficients
        self.state = np.zeros((2, 3))

    def __call__(self, value: np.ndarray) -> np.ndarray:
        out = self.above[0] * value + self.state[0]
        self.state[0] = self.above[1] * value - self.below[1] * out + self.state[1]
        self.state[1] = self.above[2] * value - self.below[2] * out
        return out


def gains(drone: Drone) -> dict[str, float]:
    """Returns gains as a pilot would have tuned them: lower for a slow motor."""
    share = min(1.0, 0.025 / drone.motor_time_constant)
    usual = {"P": 0.15, "I": 0.2, "D": 0.003}
    named = {
        f"MC_{axis}RATE_{name}": share * value
        for axis in ("ROLL", "PITCH")
        for name, value in usual.items()
    }
    return named | {"MC_YAWRATE_P": 0.2, "MC_YAWRATE_I": 0.1, "MC_YAWRATE_D": 0.0}


def fly(drone: Drone, generator: np.random.Generator) -> Signals:
    """Flies a drone by tilts that a pilot asks for."""
    rows, period = round(SECONDS * RATE), 1 / RATE
    controller = gains(drone)
    p, i, d = (
        np.array([controller[f"MC_{axis}RATE_{name}"] for axis in ("ROLL", "PITCH", "YAW")])
        for name in "PID"
    )
    full = MASS * GRAVITY * drone.thrust_to_weight / 4
    to_torque = px4_allocation.effectiveness(ROTORS) / ROTORS[0].thrust
    hover = np.sqrt(1 / drone.thrust_to_weight)
    late = max(0, round(drone.latency * RATE))
    gyro_filter, change_share = _Filter(40.0), 1 / (1 + RATE / (2 * np.pi * 30.0))
    command = np.full((rows + late, 4), hover)
    answer = Signals(*(np.zeros((rows, n)) for n in (3, 3, 3, 4, 4)))
    noise = generator.normal(size=(rows, 9))
    steps = np.repeat(generator.uniform(-1, 1, (rows // 960 + 1, 3)), 960, axis=0)[:rows]
    speed, rates, attitude = np.full(4, hover), np.zeros(3), np.zeros(3)
    integral, before, change = np.zeros(3), np.zeros(3), np.zeros(3)
    gust, climb, tilt_command = np.zeros(3), 0.0, np.zeros(3)
    for row in range(rows):
        reading = rates + 0.3 * noise[row, :3]
        quiet = gyro_filter(reading)
        change += change_share * ((quiet - before) * RATE - change)
        before = quiet
        tilt_command += period / 0.15 * (steps[row] * [0.25, 0.25, 1.0] - tilt_command)
        tilt = 6.5 * (tilt_command[:2] - attitude[:2])
        setpoint = np.array([*tilt, 0.3 * tilt_command[2]])
        error = setpoint - quiet
        torque = p * error + integral - d * change
        integral = np.clip(integral + period * i * error, -0.3, 0.3)
        push = hover * (1 - 0.25 * (climb - tilt_command[2])) / np.prod(np.cos(attitude[:2]))
        demand = np.array([*torque, -np.clip(push, 0.1, 0.95)])
        command[row + late] = px4_allocation.motors(demand[None], ROTORS)[0]
        speed = speed + (1 - np.exp(-period / drone.motor_time_constant)) * (command[row] - speed)
        torques = to_torque @ (full * speed**2)
        gust += period / 0.3 * -gust + np.sqrt(period) * 0.06 * noise[row, 3:6]
        force = (torques[3] + MASS * 1.0 * gust[2]) / MASS - 0.3 * -climb
        answer.rates[row], answer.force[row, 2] = reading, force + noise[row, 6]
        answer.force[row, :2] = 0.3 * noise[row, 7:]
        answer.rate_setpoint[row], answer.torque_thrust[row] = setpoint, demand
        answer.motors[row] = command[row + late]
        moment = torques[:3] + gust - np.cross(rates, drone.inertia * rates)
        rates = rates + period * moment / drone.inertia
        attitude = attitude + period * rates
        climb += period * (-force * np.prod(np.cos(attitude[:2])) - GRAVITY)
    return answer


def topics_of(signals: Signals) -> dict[str, dict[str, np.ndarray]]:
    """Returns the topics of PX4's default profile, with the fields' names in a ULog."""
    stamps = 10_000_000 + np.round(1e6 / RATE * np.arange(len(signals.rates))).astype(np.int64)
    many = EVERY["sensor_combined"]
    count = len(stamps) // many * many

    def mean(values: np.ndarray) -> np.ndarray:
        return values[:count].reshape(-1, many, values.shape[1]).mean(axis=1)

    def vector(field: str, values: np.ndarray) -> dict[str, np.ndarray]:
        return {f"{field}[{place}]": values[:, place] for place in range(values.shape[1])}

    span = np.full(count // many, many * 1e6 / RATE)
    # A mean ends with the last of its samples.
    combined = {"timestamp": stamps[many - 1 : count : many] + round(0.5e6 / RATE)}
    combined |= vector("gyro_rad", mean(signals.rates))
    combined |= vector("accelerometer_m_s2", mean(signals.force))
    combined |= {"gyro_integral_dt": span, "accelerometer_integral_dt": span}
    some = slice(None, None, EVERY["set-points"])
    at = {"timestamp": stamps[some], "timestamp_sample": stamps[some]}
    demands = signals.torque_thrust[some]
    down = np.column_stack([np.zeros((len(demands), 2)), demands[:, 3]])
    names = zip(("roll", "pitch", "yaw"), signals.rate_setpoint[some].T, strict=True)
    motors = slice(None, None, EVERY["actuator_motors"])
    rare = stamps[:: EVERY["battery_status"]]
    return {
        "sensor_combined": combined,
        "vehicle_torque_setpoint": at | vector("xyz", demands[:, :3]),
        "vehicle_thrust_setpoint": at | vector("xyz", down),
        "vehicle_rates_setpoint": at | dict(names),
        "actuator_motors": {"timestamp": stamps[motors], "timestamp_sample": stamps[motors]}
        | vector("control", signals.motors[motors]),
        "battery_status": {"timestamp": rare, "voltage_v": np.full(len(rare), 15.5)},
    }


def parameters_of(drone: Drone) -> dict[str, float]:
    """Returns PX4's parameters of a drone."""
    values = {"CA_ROTOR_COUNT": 4.0, "IMU_GYRO_RATEMAX": float(RATE), "IMU_GYRO_CUTOFF": 40.0}
    for number, one in enumerate(ROTORS):
        place = {"PX": one.forward, "PY": one.right, "KM": one.moment}
        values |= {f"CA_ROTOR{number}_{key}": float(value) for key, value in place.items()}
    return values | gains(drone)


def read_log(drone: Drone, generator: np.random.Generator, name: str) -> list[Flight]:
    """Flies a drone; returns its checked flights, as read from its log."""
    flight, time, notes = px4.flight(name, topics_of(fly(drone, generator)), parameters_of(drone))
    return check_log([Logged(name, [(flight, time)], notes)]).pieces


def judge_drones(seeds: range) -> Iterator[dict[str, Any]]:
    """Yields a row for each drone and quantity: the estimate over the truth, and its interval."""
    start = read_start("x500", 1e3 * MASS).parameters
    for seed in seeds:
        generator = np.random.default_rng(seed)
        drone = draw_drone(generator)
        result = mf.identify(
            read_log(drone, generator, f"drone_{seed}"), start=start, key=jax.random.key(seed)
        )
        draws = dict(result.posterior)
        if {"motor_time_constant", "latency"} <= draws.keys():
            draws["lag + latency"] = draws["motor_time_constant"] + draws["latency"]
        truth = {
            "thrust_to_weight": drone.thrust_to_weight,
            "motor_time_constant": drone.motor_time_constant,
            "lag + latency": drone.motor_time_constant + drone.latency,
            "inertia_x": drone.inertia[0],
            "inertia_y": drone.inertia[1],
        }
        for name, value in truth.items():
            is_identified = name in result.estimates or (
                name == "lag + latency" and "motor_time_constant" in result.estimates
            )
            row = {"drone": seed, "quantity": name, "truth": value, "identified": is_identified}
            if name in draws:
                low, middle, high = np.quantile(draws[name], [0.025, 0.5, 0.975]) / value
                row |= {"estimate": middle, "low": low, "high": high, "inside": low <= 1 <= high}
            yield row


def main() -> None:
    """Writes the table and prints it."""
    require_packages("pyulog")
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drones", type=int, default=6)
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    parser.add_argument("-o", "--output", type=Path, default=Path("planted_px4"))
    arguments = parser.parse_args()
    rows = list(judge_drones(range(arguments.first, arguments.first + arguments.drones)))
    table = polars.DataFrame(rows, infer_schema_length=None)
    results.write(arguments.output / "planted_px4.csv", table.write_csv())
    with polars.Config(tbl_rows=200, tbl_cols=20, tbl_hide_dataframe_shape=True):
        print(table)


if __name__ == "__main__":
    main()
