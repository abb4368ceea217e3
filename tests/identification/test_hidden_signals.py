"""A signal that a log has makes no answer worse: hidden, intervals are no narrower."""

import dataclasses
from collections.abc import Mapping

import jax
import numpy as np
import pytest

import maidenflight as mf
from maidenflight.flights.log import Flight
from maidenflight.flights.trims import rotors
from maidenflight.identification.identify import identify
from maidenflight.identification.methods import Likelihood
from maidenflight.parameters import component, crazyflie, replace
from maidenflight.simulator.physics.dynamics import equivalent_lag
from maidenflight.simulator.realities.virtual_drone import virtual_drone

DRONE = virtual_drone(1)
TRUTH = DRONE.parameters
START = replace(crazyflie(), mass=TRUTH.mass)
WIDER, WORSE = 1.1, 0.02
"""Factor by which an interval may be wider, and share by which an error may be larger."""


def recorded() -> list[Flight]:
    """Returns two flights with a state, an accelerometer and the rotors' speeds."""
    flights = mf.record(DRONE, jax.random.key(1), flights=2, duration=6.0, excitation=0.05)
    random = np.random.default_rng(0)

    def with_speeds(flight: Flight) -> Flight:
        # Speeds at the end of a row's period are those of the next row.
        speed = 2500.0 * np.roll(rotors(flight, TRUTH).speed, 1, axis=0)
        speed[0] = speed[1]
        noisy = speed + random.normal(0.0, 5.0, speed.shape)
        return dataclasses.replace(flight, rotor_speed=noisy.astype(np.float32))

    return [with_speeds(one) for one in flights]


def without(flights: list[Flight], signal: str) -> list[Flight]:
    """Returns flights without a signal; the state is position, velocity and attitude."""
    if signal != "state":
        return [dataclasses.replace(one, **{signal: None}) for one in flights]
    unknown = np.full_like(flights[0].position, np.nan)
    names = ("position", "velocity", "attitude")
    return [dataclasses.replace(one, **dict.fromkeys(names, unknown)) for one in flights]


def judged(flights: list[Flight]) -> dict[str, tuple[float, float]]:
    """Error and width of the interval, shares of the truth, by parameter that the flights tell."""
    found = identify(flights, Likelihood(trials=1), start=START, key=jax.random.key(0))
    samples = dict(found.posterior)
    ratio = samples.get("spin_down_ratio", float(found.parameters.spin_down_ratio))
    draws = {"lag": equivalent_lag(samples["motor_time_constant"], ratio) + samples["latency"]}
    truth: Mapping[str, float] = {
        "lag": equivalent_lag(float(TRUTH.motor_time_constant), float(TRUTH.spin_down_ratio))
        + float(TRUTH.latency)
    }
    names = ("thrust_to_weight", "inertia_x", "inertia_y", "spin_down_ratio")
    draws |= {name: samples[name] for name in names if name in found.estimates}
    truth = {**truth, **{name: float(component(TRUTH, name)) for name in names}}
    judged = {}
    for name, values in draws.items():
        low, middle, high = np.quantile(values, [0.025, 0.5, 0.975]) / truth[name]
        judged[name] = abs(float(middle) - 1.0), float(high - low)
    return judged


@pytest.mark.parametrize(
    "others",
    [
        pytest.param((), marks=pytest.mark.slow),
        pytest.param(("state",), marks=pytest.mark.night),
    ],
)
def test_measured_speeds_make_no_answer_worse(others: tuple[str, ...]) -> None:
    flights = recorded()
    for other in others:
        flights = without(flights, other)
    having, lacking = judged(flights), judged(without(flights, "rotor_speed"))
    for name in having.keys() & lacking.keys():
        (error, width), (error_without, width_without) = having[name], lacking[name]
        assert width < WIDER * width_without, name
        assert error < error_without + WORSE, name
