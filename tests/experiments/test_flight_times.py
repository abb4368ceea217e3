"""Flight times follow from physics and guards, and tell of the real ones what the authors' logs
allow."""

import dataclasses
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import polars
import pytest

from maidenflight.errors import InputError
from maidenflight.experiments import comparison
from maidenflight.experiments.conditions import CURRENT, controller_as_flown, read_conditions
from maidenflight.experiments.flight_times import (
    describe_alike,
    outlives,
    predict_flight_times,
    summary,
)
from maidenflight.flying import guarded
from maidenflight.parameters import Parameters, crazyflie, noiseless, replace
from maidenflight.policy import Policy, untrained_policy
from maidenflight.simulator import environment, stepping
from maidenflight.simulator.controllers import control, interface
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics import battery, dynamics, rotations
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.tasks import failures, tasks
from maidenflight.simulator.tasks.look_ahead import NONE, LookAhead

KEY = jax.random.key(0)
SETTINGS = Path(__file__).parents[2] / "paper" / "settings"
GRONAUER_2021 = read_conditions(SETTINGS / "gronauer_2021.toml")
STILL = GRONAUER_2021._replace(start=CURRENT.start)
RATES = {"pwm": 100, "attitude_rate": 50, "attitude": 25}
SHORT = {"trials": 3, "duration": 3.0}
"""Arguments that share one compilation."""


def constant(action: tuple[float, ...], kind: str = "pwm") -> Policy:
    """A policy that always does the same."""
    made = jax.tree.map(jnp.zeros_like, untrained_policy(KEY, spec=PolicySpec(hidden=(8,))))
    made = dataclasses.replace(
        made,
        biases=(made.biases[0], jnp.array(action, jnp.float32)),
        observation_std=jnp.ones(40),
    )
    return dataclasses.replace(made, interface=interface.INTERFACES[kind]())


def restless(kind: str, number: int, look_ahead: LookAhead = NONE) -> Policy:
    """A policy that feels what it sees, its last actions among it, and loses control."""
    made = untrained_policy(
        jax.random.key(number), spec=PolicySpec(look_ahead=look_ahead, hidden=(8,))
    )
    weights = (made.weights[0], made.weights[1] * 8)
    return dataclasses.replace(made, weights=weights, interface=interface.INTERFACES[kind]())


@pytest.mark.parametrize("kind", ["pwm", pytest.param("attitude_rate", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("farthest", "reason"), [(0.25, "position error"), (0.6, "position error"), (2.5, "height")]
)
def test_a_drone_that_cuts_its_motors_falls_as_newton_says_until_the_guard_trips(
    kind: str, farthest: float, reason: str
) -> None:
    drone = noiseless(crazyflie())
    lag, delay = float(drone.motor_time_constant), float(drone.latency)
    time = np.arange(0, 2, 1e-3)
    since = np.maximum(time - delay, 0)
    # nu falls like exp(-t/T_m), thrust like its square; twice integrated.
    height = 9.81 * (since**2 / 2 - lag / 2 * since + lag**2 / 4 * (1 - np.exp(-2 * since / lag)))
    angle = 2 * np.pi * time / 3
    away = np.sqrt(height**2 + (0.25 * (1 - np.cos(angle))) ** 2 + (0.25 * np.sin(angle)) ** 2)
    expected = time[np.argmax((away > farthest) | (height > 1.0))]
    fallen = predict_flight_times(
        [constant((-1, 0, 0, 0) if kind != "pwm" else (-1,) * 4, kind)],
        drone,
        KEY,
        conditions=STILL._replace(guard=STILL.guard._replace(position_error=farthest)),
        **SHORT,
    )
    assert set(fallen["end_reason"]) == {reason}
    np.testing.assert_allclose(fallen["duration"], expected, atol=0.011)


@pytest.mark.slow
def test_a_policy_that_rolls_at_60_deg_a_second_meets_the_tilt_guard_after_half_a_second() -> None:
    rolled = predict_flight_times(
        [constant((0.2, 1.0, 0.0, 0.0), "attitude_rate")],
        noiseless(crazyflie()),
        KEY,
        conditions=STILL,
        **SHORT,
    )
    assert set(rolled["end_reason"]) == {"tilt"}
    assert rolled["duration"].is_between(0.45, 0.7).all()


@pytest.mark.parametrize(
    ("attitude", "body_rates", "position", "reason"),
    [
        ((29.5, -29.5, 170.0), (790.0, -790.0, 2000.0), (2.4, 0.0, 1.0), ""),
        ((0.0, 30.5, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), "tilt"),
        ((0.0, 30.5, 0.0), (0.0, -801.0, 0.0), (0.0, 0.0, 1.0), "body rate"),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 2.6, 1.0), "position error"),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, -0.01), "height"),
    ],
)
def test_the_guard_is_the_papers_on_what_the_sensors_tell(
    attitude: tuple, body_rates: tuple, position: tuple, reason: str
) -> None:
    place = jnp.array(position, jnp.float32)
    seen = Measurement(
        place,
        jnp.zeros(3),
        rotations.from_attitude(jnp.radians(jnp.array(attitude))),
        jnp.radians(jnp.array(body_rates, jnp.float32)),
    )
    env = Environment()
    begun = environment.begin(
        env, dynamics.at_hover(place, crazyflie()), jnp.zeros(()), crazyflie(), KEY
    )
    found, seen_now = guarded.end_reason(
        begun._replace(measurement=seen), jnp.array([0.0, 0.0, 1.0]), GRONAUER_2021.guard
    )
    assert failures.END_REASONS[int(found)] == reason
    away = np.linalg.norm(np.subtract(position, (0.0, 0.0, 1.0)))
    assert float(seen_now.position_error) == pytest.approx(away, rel=1e-5)


@pytest.mark.parametrize(
    "look_ahead",
    [
        pytest.param(NONE, marks=pytest.mark.slow),
        pytest.param(LookAhead(3, 0.2), marks=pytest.mark.night),
    ],
)
def test_policies_see_the_history_and_hold_the_actions_of_their_own_rate(
    look_ahead: LookAhead,
) -> None:
    """As in an environment that acts at that rate: its layout is held against the drone's logs.
    Only the guard looks more often."""
    structure = controller_as_flown(interface.attitude())
    policies = [restless("attitude", number, look_ahead) for number in range(4)]
    drone = replace(noiseless(crazyflie()), time_step=control.time_step(structure))
    env = Environment.matching(
        drone,
        tasks.paper_circle(),
        structure,
        spec=PolicySpec(look_ahead=look_ahead),
        thrust_law=battery.law_for(structure.interface.full_scale_counts),
    )
    state = STILL.start.draw(env, drone, KEY)

    @jax.jit
    def fly(policy: Policy) -> jax.Array:
        def one(env_state: environment.EnvState, _: None) -> tuple[environment.EnvState, jax.Array]:
            after = stepping.step(
                env, env_state, policy(environment.observation(env, env_state)), drone, KEY
            )[0]
            return after, jnp.max(jnp.abs(rotations.to_attitude(after.measurement.quaternion)[:2]))

        first = environment.begin(env, state, jnp.zeros(()), drone, KEY)
        return jax.lax.scan(one, first, None, length=75)[1]

    far = STILL._replace(guard=STILL.guard._replace(position_error=1e6))
    flown = predict_flight_times(policies, drone, KEY, conditions=far, trials=1, duration=3.0)
    assert flown["end_reason"].to_list() == ["tilt"] * 4
    for policy, duration in zip(policies, flown["duration"].to_list(), strict=True):
        assert int(np.argmax(np.asarray(fly(policy)) > np.radians(30))) + 1 == np.ceil(
            round(duration * 100) / 4
        )


def test_a_seed_gives_the_same_flights_and_another_seed_others() -> None:
    policies = [restless("pwm", number) for number in range(2)]
    flown = predict_flight_times(policies, crazyflie(), KEY, **SHORT)
    assert flown.equals(predict_flight_times(policies, crazyflie(), KEY, **SHORT))
    assert not flown.equals(predict_flight_times(policies, crazyflie(), jax.random.key(1), **SHORT))
    assert flown.columns[:4] == ["policy", "control", "duration", "end_reason"]
    assert flown.columns[4:] == ["trial", "drone", *comparison.LARGEST, *comparison.ERRORS]
    assert set(flown["drone"]) == {1}
    for row in flown.filter(end_reason="tilt").iter_rows(named=True):
        assert np.radians(30.0) < row["largest_tilt"] < np.radians(90.0)
        assert 0.0 < row["estimated_error"] <= row["largest_distance"]
        assert row["position_error"] > 0.0
    assert flown["policy"].to_list() == ["policy_1"] * 3 + ["policy_2"] * 3


def test_errors_are_true_and_as_the_drone_estimates_them_which_drift_alone_tells_apart() -> None:
    def difference(walk: float) -> float:
        drone = replace(noiseless(crazyflie()), position_walk=np.float32(walk))
        (flown,) = predict_flight_times([constant((0.0,) * 4)], drone, KEY, **SHORT).partition_by(
            "policy"
        )
        errors = (flown[name].to_numpy() for name in comparison.ERRORS)
        return float(np.max(np.abs(np.subtract(*errors))))

    assert difference(0.0) < 1e-3
    assert 0.01 < difference(0.3) < 1.0


def times(flown: polars.DataFrame) -> list:
    return flown.select("policy", "trial", "duration", "end_reason").rows()


@pytest.mark.slow
def test_a_policys_flights_are_its_own_whoever_flies_beside_it() -> None:
    """Also policies of other sizes, histories and control structures, more trials, and less
    time."""
    policies = [restless(kind, number) for kind in ("pwm", "attitude") for number in range(3)]
    policies.insert(1, untrained_policy(KEY))
    assert policies[0].layer_sizes != policies[1].layer_sizes
    names = [f"policy {number}" for number in range(len(policies))]
    together = predict_flight_times(policies, crazyflie(), KEY, names=names, **SHORT)
    assert together["policy"].unique(maintain_order=True).to_list() == names
    for name, policy in zip(names, policies, strict=True):
        alone = predict_flight_times(
            [policy], crazyflie(), KEY, names=[name], trials=5, duration=3.0
        )
        assert times(alone)[:3] == times(together.filter(polars.col("policy") == name))
    cut = predict_flight_times(policies, crazyflie(), KEY, names=names, trials=3, duration=0.5)
    assert cut["duration"].to_list() == [min(duration, 0.5) for duration in together["duration"]]
    assert set(cut.filter(polars.col("duration") == 0.5)["end_reason"]) <= {"time limit", "tilt"}


def test_many_policies_of_many_trials_are_told_of_as_they_land() -> None:
    policies, told = [restless("pwm", number) for number in range(12)], []
    flown = predict_flight_times(
        policies,
        crazyflie(),
        KEY,
        trials=20,
        duration=3.0,
        on_policy=lambda *done: told.append(done),
    )
    assert told == [(number, 12) for number in range(1, 13)]
    assert flown.height == 240
    assert flown["trial"].to_list() == list(range(1, 21)) * 12
    few = predict_flight_times(
        policies[-1:], crazyflie(), KEY, trials=20, duration=3.0, names=["policy_12"]
    )
    assert times(flown.tail(20)) == times(few)


DEVICES = """
import sys
import jax
jax.config.update("jax_num_cpu_devices", 2)
sys.path.insert(0, sys.argv[1])
from test_flight_times import KEY, SHORT, UNEVEN, crazyflie, predict_flight_times, times
print(times(predict_flight_times(UNEVEN, crazyflie(), KEY, **SHORT)))
assert jax.device_count() == 2
"""
UNEVEN = [constant((0.2, 0.2, 0.2, 0.2 - 0.02 * number)) for number in range(3)]
"""Policies that fall, and do not answer: what answers quickly makes flights of roundings, which
depend on how it was compiled."""


@pytest.mark.night
def test_two_devices_give_what_one_gives() -> None:
    done = subprocess.run(
        [sys.executable, "-c", DEVICES, str(Path(__file__).parent)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    alone = times(predict_flight_times(UNEVEN, crazyflie(), KEY, **SHORT))
    assert done.stdout.strip() == str(alone)


def stacked(*drones: Parameters) -> Parameters:
    return jax.tree.map(lambda *leaves: np.stack(leaves), *drones)


def test_an_ensemble_of_equal_drones_is_the_drone_and_of_unequal_ones_each_in_turn() -> None:
    policies = [restless("pwm", number) for number in range(2)]
    flown = predict_flight_times(policies, crazyflie(), KEY, **SHORT)
    equal = predict_flight_times(policies, stacked(*[crazyflie()] * 5), KEY, **SHORT)
    assert flown.drop("drone").equals(equal.drop("drone"))
    weak, strong = (noiseless(replace(crazyflie(), thrust_to_weight=ratio)) for ratio in (1.0, 1.6))
    hover = [constant((0.25,) * 4)] * 2
    single = [
        predict_flight_times(hover, drone, KEY, conditions=STILL, **SHORT)["duration"].to_list()
        for drone in (weak, strong)
    ]
    mixed = predict_flight_times(hover, stacked(weak, strong), KEY, conditions=STILL, **SHORT)[
        "duration"
    ].to_list()
    assert len({single[0][0], single[1][0]}) == 2
    assert set(mixed) == {single[0][0], single[1][0]}


def test_a_summary_tells_means_quantiles_and_ends_of_each_policy() -> None:
    flights = polars.DataFrame(
        {
            "policy": ["b", "b", "b", "a"] + ["c"] * 16,
            "control": ["pwm"] * 20,
            "trial": [1, 2, 3, 1, *range(1, 17)],
            "duration": [1.0, 2.0, 6.0, 20.0, *np.arange(1.0, 17.0)],
            "end_reason": ["tilt", "tilt", "height", "time limit"] + ["tilt"] * 16,
        }
    )
    told = summary(flights)
    assert told["policy"].to_list() == ["b", "a", "c"]
    assert told["trials"].to_list() == [3, 1, 16]
    np.testing.assert_allclose(told["mean"], [3.0, 20.0, 8.5])
    # Of 17 alike one more is below the first with a probability of 1/17.
    np.testing.assert_allclose(told["quantile_10"], [1.0, 20.0, 1.7])
    np.testing.assert_allclose(told["quantile_50"], [2.0, 20.0, 8.5])
    np.testing.assert_allclose(told["quantile_90"], [6.0, 20.0, 15.3])
    np.testing.assert_allclose(told["tilt"], [2 / 3, 0.0, 1.0])
    np.testing.assert_allclose(told.select("time limit", "height", "tilt").sum_horizontal(), 1.0)


def test_of_two_policies_it_is_told_which_outlives_the_other() -> None:
    times = {"b": [1.0, 2.0, 6.0], "a": [2.0, 6.0, 20.0], "c": [0.5, 0.5, 0.5]}
    flights = polars.DataFrame(
        [(name, "pwm", one, "tilt") for name, own in times.items() for one in own],
        schema=["policy", "control", "duration", "end_reason"],
        orient="row",
    )
    chances = outlives(flights)
    # Of nine pairs b is longer in one, as long in two.
    np.testing.assert_allclose(chances, [[0.5, 2 / 9, 1.0], [7 / 9, 0.5, 1.0], [0.0, 0.0, 0.5]])
    told = flights.group_by("policy", maintain_order=True).agg(mean=polars.col("duration").mean())
    (note,) = describe_alike(told, chances[:, 1])
    assert note.startswith("a cannot be told apart from b, whose")
    assert describe_alike(told, np.array([0.1, 0.5, 0.0])) == []


@pytest.mark.parametrize(
    ("policies", "settings", "message"),
    [
        ([], {}, "0 policies"),
        ([constant((0,) * 4)], {"trials": 0}, "0 trials"),
        ([constant((0,) * 4)], {"names": ["a", "b"]}, "2 names"),
        ([constant((0,) * 4)] * 2, {"names": ["a", "a"]}, "a name for each"),
        ([constant((0,) * 4)], {"duration": 0.001}, "at least 0.01 s"),
        (
            [dataclasses.replace(constant((0,) * 4), interface=interface.pwm(30))],
            {"names": ["slow.json"]},
            "slow.json: pwm at 30 Hz, which does not divide",
        ),
    ],
)
def test_what_cannot_be_flown_is_refused(
    policies: list[Policy], settings: dict, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        predict_flight_times(policies, crazyflie(), KEY, **settings)
