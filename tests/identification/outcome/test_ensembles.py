import dataclasses

import numpy as np
import pytest

from made_flights import calm
from maidenflight.errors import InputError
from maidenflight.flights.trims import trim
from maidenflight.identification.drone_file import Estimate
from maidenflight.identification.likelihood.flight_differences import (
    WITHIN_A_DAY,
    drone_of_the_day,
    flight_to_flight_sd,
    trim_ensemble,
)
from maidenflight.parameters import component, crazyflie

TURNED = np.array([0.50, 0.54, 0.50, 0.54])
"""Commands that turn a drone about z, which a constant torque must balance."""


def held(rows: int = 300, seed: int = 0, turned: np.ndarray = TURNED):
    """A flight near hover by a held command, with a little noise."""
    noise = 0.01 * np.random.default_rng(seed).standard_normal((rows, 4))
    return calm(rows, seed, command=(turned + noise).astype(np.float32))


def estimates(deviation: float) -> dict[str, Estimate]:
    return {"torque_bias_z": Estimate(0.0, (-1e-4, 1e-4), (0.0,), deviation)}


def test_the_trim_of_the_day_lies_between_the_file_and_the_flight_as_they_are_sure() -> None:
    drone = crazyflie()
    measured = trim([held()], drone).torque_bias[2]
    assert measured < -3e-5
    found = {
        deviation: drone_of_the_day(drone, estimates(deviation), [held()], "x")
        for deviation in (1e-7, 4e-5, 1e-2)
    }
    values = [float(component(drone, "torque_bias_z")) for drone, _ in found.values()]
    assert values[0] == pytest.approx(0.0, abs=1e-6)
    assert measured < values[1] < 0.5 * measured
    # Where nothing was known a flight tells all but what differs within a day.
    assert values[2] == pytest.approx(
        measured * (1.0 - WITHIN_A_DAY["torque_bias_z"] ** 2), rel=0.02
    )
    for drone, told in found.values():
        estimate = told["torque_bias_z"]
        assert estimate.value == pytest.approx(float(component(drone, "torque_bias_z")), abs=1e-9)
        assert estimate.interval[0] < estimate.value < estimate.interval[1]
    assert found[4e-5][1]["torque_bias_z"].between_sd < 4e-5


def test_the_thrust_of_the_day_is_told_too_where_it_was_identified() -> None:
    drone = crazyflie()
    told = estimates(4e-5) | {"thrust_to_weight": Estimate(1.725, (1.7, 1.75), (1.725,), 0.2)}
    found, told = drone_of_the_day(drone, told, [held()], "x")
    measured = trim([held()], drone).thrust_to_weight
    assert float(found.thrust_to_weight) == pytest.approx(told["thrust_to_weight"].value)
    assert min(measured, 1.725) < float(found.thrust_to_weight) < max(measured, 1.725)
    only_torques = drone_of_the_day(drone, estimates(4e-5), [held()], "x")[0]
    assert float(only_torques.thrust_to_weight) == pytest.approx(1.725)


def test_thrust_differs_too_where_it_was_identified() -> None:
    told = estimates(4e-5) | {"thrust_to_weight": Estimate(1.725, (1.7, 1.75), (1.725,), 0.05)}
    drones = trim_ensemble(crazyflie(), told, "x").drones
    assert np.std(drones.thrust_to_weight) == pytest.approx(0.05, rel=0.05)
    assert np.std(np.asarray(drones.torque_bias)[:, 2]) == pytest.approx(4e-5, rel=0.05)
    assert not np.any(np.ptp(np.asarray(drones.torque_bias)[:, :2], axis=0))
    assert not np.ptp(trim_ensemble(crazyflie(), estimates(4e-5), "x").drones.thrust_to_weight)
    told["thrust_to_weight"] = dataclasses.replace(told["thrust_to_weight"], between_sd=0.6)
    drones = trim_ensemble(crazyflie(), told, "x").drones
    assert np.all(np.asarray(drones.thrust_to_weight) > 1.0)  # they lifted their weight


def test_more_flights_of_the_day_tell_more() -> None:
    flights = [dataclasses.replace(held(seed=seed), name=f"flight {seed}") for seed in range(4)]
    pieces = [dataclasses.replace(flight, name="flight") for flight in flights]
    one, four, joined = (
        drone_of_the_day(crazyflie(), estimates(4e-5), some, "x")[1]["torque_bias_z"]
        for some in (flights[:1], flights, pieces)
    )
    assert four.between_sd < one.between_sd
    assert abs(four.value) > abs(one.value)
    # Pieces of one flight are no more than a longer flight.
    known = [estimate.between_sd for estimate in (one, joined, four)]
    assert known[0] - known[1] < 0.5 * (known[0] - known[2])
    assert abs(joined.value) < abs(four.value)


def test_what_tells_no_trim_is_refused() -> None:
    with pytest.raises(InputError, match="torque_bias"):
        drone_of_the_day(crazyflie(), {}, [held()], "mine.toml")
    with pytest.raises(InputError, match="1 flights"):
        drone_of_the_day(crazyflie(), estimates(4e-5), [held(30)], "mine.toml")


def test_flights_count_alike_however_long_they_are() -> None:
    """Nine short flights turn to both sides; a long one, which turns to neither, is one of ten."""
    shares = np.linspace(-0.04, 0.04, 9)
    short = [
        held(200, seed, 0.5 + share * np.array([-1, 1, -1, 1])) for seed, share in enumerate(shares)
    ]
    flights = [
        dataclasses.replace(one, name=f"{number}.csv")
        for number, one in enumerate([*short, held(2000, 9, np.full(4, 0.5))])
    ]
    drone = crazyflie()
    torques = [trim([one], drone).torque_bias[2] for one in flights]
    told = estimates(1e-7) | {"latency": Estimate(0.01, (0.0, 0.02), (0.01,), 0.001)}
    found = flight_to_flight_sd(told, flights, drone)
    assert set(found) == {"torque_bias_z"}
    assert found["torque_bias_z"].between_sd == pytest.approx(np.std(torques, ddof=1), rel=0.05)
    assert found["torque_bias_z"].value == told["torque_bias_z"].value
    assert flight_to_flight_sd(told, flights[:7], drone) == {}
    assert flight_to_flight_sd({"latency": told["latency"]}, flights, drone) == {}
