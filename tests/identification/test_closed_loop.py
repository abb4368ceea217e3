from typing import Any

import jax
import numpy as np
import pytest

from flying_policy import flying_policy
from made_flights import calm
from maidenflight.errors import InputError
from maidenflight.flying import engine
from maidenflight.identification.behaviour import BEHAVIOUR
from maidenflight.identification.closed_loop import PRIOR, ClosedLoop, match
from maidenflight.parameters import crazyflie, replace
from maidenflight.simulator.controllers import control
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.tasks import tasks

NOISY: dict[str, Any] = {"position_walk": 0.05, "velocity_walk": 0.05, "gyro_noise": 0.03}
START = replace(crazyflie(), motor_time_constant=0.05, latency=0.006, **NOISY)
POLICIES = {f"gain {gain}": flying_policy(START, gain) for gain in (1.0, 2.0, 3.0, 4.0)}


@pytest.mark.slow
def test_loops_that_are_nearer_to_instability_are_told_from_their_flights() -> None:
    """Drones with more latency and noise than the start: both come out nearer to the truth, and
    the policies behave more alike."""
    truth = replace(START, latency=0.013, gyro_noise=0.045)
    env = Environment.matching(
        control.in_fitting_steps(truth, control.pwm()), tasks.circle(), control.pwm()
    )
    drone = control.in_fitting_steps(truth, control.pwm())
    fly = jax.jit(
        lambda policy, keys: jax.vmap(
            lambda key: engine.simulate(env, lambda seen, _: policy(seen), drone, key, 640)
        )(keys)
    )
    flown = {}
    for number, (name, policy) in enumerate(POLICIES.items()):
        keys = jax.random.split(jax.random.key(number), 6)
        rows = jax.tree.map(np.asarray, fly(policy, keys))
        names = ("position", "velocity", "attitude", "body_rates")
        flown[name] = [
            calm(640, command=rows.ratio[one], **{part: getattr(rows, part)[one] for part in names})
            for one in range(len(keys))
        ]
    heard: list[float] = []
    settings = ClosedLoop(flights=6, steps=4)
    found = match(
        flown,
        POLICIES,
        START,
        jax.random.key(9),
        settings,
        on_step=lambda done, of, cost: heard.append(cost),
    )
    assert set(found.estimates) <= set(PRIOR)
    assert (found.policies, found.flights) == (4, 24)
    assert found.before.shape == found.after.shape == (len(BEHAVIOUR),)
    assert found.cost[1] < 0.6 * found.cost[0]
    assert heard == sorted(heard, reverse=True)
    latency, error = found.estimates["latency"]
    assert abs(latency - 0.013) < min(0.0035, max(4 * error, 0.002))
    assert abs(float(found.drones.latency) - latency) < 1e-9
    assert found.estimates["gyro_noise"][0] > 0.034
    assert np.abs(found.after).max() < np.abs(found.before).max()
    with pytest.raises(InputError, match="no policy flew"):
        match({"gain 1.0": [calm(30)]}, POLICIES, START, jax.random.key(0), settings)
