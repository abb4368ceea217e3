"""The objective: nothing is lost at the truth, something everywhere else, and its arithmetic is the
paper's."""

import jax.numpy as jnp
import numpy as np
import pytest

import planted
from maidenflight.flights.windows import Windows, windows
from maidenflight.identification.methods import DISCOUNT
from maidenflight.identification.replay import objective as module
from maidenflight.identification.replay import open_loop
from maidenflight.identification.replay.objective import WEIGHTS, Objective, window_loss
from maidenflight.parameters import crazyflie, replace

TRUTH = {"thrust_to_weight": 1.75, "motor_time_constant": 0.03, "latency": 0.0125}
"""Motors so quick that 0.3 s of history tells all about them."""
DRONE = planted.drone(**TRUTH)


@pytest.fixture(scope="module")
def cut():
    return windows(planted.logs(DRONE), planted.LENGTH)


@pytest.fixture(scope="module")
def objective(cut):
    return Objective(cut, 0.01)


def some(cut, count):
    """The first windows, or all of them several times over."""
    order = np.arange(count) % len(cut.segment)
    return Windows(*(array[order] for array in cut))


def test_windows_that_the_model_itself_made_lose_almost_nothing_at_the_truth(objective):
    at_truth, elsewhere = objective(DRONE), objective(replace(DRONE, thrust_to_weight=1.76))
    assert at_truth < 0.01
    assert at_truth < elsewhere / 100


def test_a_window_whose_history_began_in_hover_loses_nothing_whatever_its_lag():
    """There the motors' speed is known exactly, so that only rounding is left."""
    slow = planted.drone(1.6, 0.11, 0.025)
    cut = windows(planted.logs(slow), planted.LENGTH)
    fresh = (np.abs(cut.command[:, 0] - 1 / 1.6) < 1e-6).all(axis=1)
    assert fresh.sum() >= planted.FLIGHTS
    losses = Objective(cut, 0.01).per_window(slow)
    assert losses[fresh].max() < 1e-3


def test_history_tells_how_fast_slow_motors_turn():
    """At the truth of slow motors the objective is a small part of what it is a tenth beside it."""
    slow = planted.drone(1.6, 0.11, 0.025)
    objective = Objective(windows(planted.logs(slow), planted.LENGTH), 0.01)
    assert (
        objective(slow)
        < min(objective(replace(slow, motor_time_constant=lag)) for lag in (0.099, 0.121)) / 2
    )


@pytest.mark.parametrize("name", TRUTH)
def test_the_loss_grows_away_from_the_truth(objective, name):
    for side in (-1, 1):
        away = [
            objective(replace(DRONE, **{name: TRUTH[name] * (1 + side * share)}))
            for share in (0.0, 0.05, 0.1, 0.2, 0.3)
        ]
        assert (np.diff(away) > 0).all()
        assert away[1] > 2 * away[0]


def test_the_loss_has_no_plateau_and_no_jump_in_the_latency(objective):
    delays = np.arange(9.0, 16.0, 0.25) * 1e-3
    losses = np.array([objective(replace(DRONE, latency=np.float32(delay))) for delay in delays])
    twelve = list(np.round(delays * 1e3, 2)).index(12.0)
    assert len({losses[twelve], losses[twelve + 2], losses[twelve + 4]}) == 3
    slopes = np.abs(np.diff(losses))
    assert slopes.max() < 3 * np.median(slopes)
    away = np.abs((delays[1:] + delays[:-1]) / 2 - 0.0125) > 5e-4
    assert slopes[away].min() > np.median(slopes) / 4


def reference(simulated, measured, weights, discount):
    """Eq. sim-opt-objective in float64 loops."""
    total = 0.0
    for t in range(len(simulated)):
        difference = simulated[t].astype(np.float64) - measured[t]
        difference[6:9] = [np.arctan2(np.sin(angle), np.cos(angle)) for angle in difference[6:9]]
        weighted = weights * difference
        total += discount ** (t + 1) * (np.abs(weighted).sum() + np.sqrt((weighted**2).sum()))
    return total


@pytest.mark.parametrize("discount", [0.95, 0.5, 1.0])
def test_the_loss_of_a_window_is_the_papers_formula(discount):
    generator = np.random.default_rng(5)
    simulated, measured = generator.uniform(-3, 3, (2, 7, 12)).astype(np.float32)
    found = window_loss(
        jnp.asarray(simulated), jnp.asarray(measured), jnp.asarray(WEIGHTS), jnp.float32(discount)
    )
    assert float(found) == pytest.approx(
        reference(simulated, measured, WEIGHTS, discount), rel=1e-5
    )


def test_one_step_is_discounted_once():
    measured, simulated = np.zeros((1, 12), np.float32), np.eye(1, 12, dtype=np.float32)
    assert float(
        window_loss(
            jnp.asarray(simulated), jnp.asarray(measured), jnp.asarray(WEIGHTS), jnp.float32(0.9)
        )
    ) == pytest.approx(180.0)


@pytest.mark.parametrize("column", [6, 7, 8])
def test_angles_on_both_sides_of_pi_are_near_each_other(column):
    simulated, measured = np.zeros((2, 1, 12), np.float32)
    simulated[0, column], measured[0, column] = np.pi - 0.01, 0.01 - np.pi
    near = float(
        window_loss(
            jnp.asarray(simulated), jnp.asarray(measured), jnp.asarray(WEIGHTS), jnp.float32(1.0)
        )
    )
    assert near == pytest.approx(2 * 0.02 * WEIGHTS[column], rel=1e-3)


def test_weights_are_per_quantity():
    np.testing.assert_array_equal(WEIGHTS, [100, 100, 100, 10, 10, 10, 1, 1, 1, 1, 1, 1])


def test_the_objective_is_the_mean_of_its_windows_loss(objective, cut):
    """Window by window, from `simulate` and the formula in float64."""
    beside = replace(DRONE, thrust_to_weight=1.8)
    losses = objective.per_window(beside)
    assert losses.shape == cut.segment.shape
    assert objective(beside) == pytest.approx(np.float64(losses).mean(), rel=1e-6)
    simulated = module.simulate(
        Windows(*(array[5] for array in cut)), replace(beside, time_step=np.float32(0.005)), 2
    )
    assert losses[5] == pytest.approx(
        reference(np.asarray(simulated), cut.measured[5], WEIGHTS, DISCOUNT), rel=1e-3
    )


def test_segments_sum_to_the_whole(objective, cut):
    blocks = objective.per_segment(crazyflie())
    assert blocks.shape == (planted.FLIGHTS,) == (objective.segments,)
    np.testing.assert_allclose(blocks.sum() / objective.size, objective(crazyflie()), rtol=1e-6)
    np.testing.assert_allclose(
        blocks[3],
        objective.per_window(crazyflie())[cut.segment == 3].sum(dtype=np.float64),
        rtol=1e-6,
    )
    np.testing.assert_array_equal(objective.windows_per_segment, np.bincount(cut.segment))


@pytest.mark.parametrize("count", [1, 100, 256, 300])
def test_filling_up_the_last_chunk_changes_nothing(objective, cut, count):
    whole = objective.per_window(crazyflie())
    part = Objective(some(cut, count), 0.01)
    assert part.size == count
    np.testing.assert_allclose(
        part.per_window(crazyflie()), whole[np.arange(count) % len(whole)], rtol=1e-5
    )


def test_one_compilation_serves_all_parameters(cut, monkeypatch):
    traces = []
    simulate = module.simulate
    monkeypatch.setattr(
        module, "simulate", lambda *arguments: traces.append(1) or simulate(*arguments)
    )
    eight = some(cut, 8)
    short = Objective(
        eight._replace(command=eight.command[:, :-26], measured=eight.measured[:, :-26]), 0.01
    )
    values = [
        short(drone)
        for drone in (
            crazyflie(),
            DRONE,
            planted.drone(2.4, 0.4, 0.0),
            planted.drone(1.5, 0.01, 0.05),
        )
    ]
    assert len(set(values)) == 4
    assert len(traces) == 1


@pytest.mark.slow
def test_what_is_computed_does_not_depend_on_the_number_of_cores(monkeypatch):
    """To the last bit: 600 windows in three chunks, of all and of every second."""
    measured, at = (
        Objective(some(windows(planted.logs(DRONE), planted.LENGTH), 600), 0.01),
        replace(DRONE, thrust_to_weight=1.8),
    )
    found = {}
    for cores in (1, 2, 3, 64):
        monkeypatch.setattr(open_loop.compiler, "count_cores", lambda cores=cores: cores)
        found[cores] = (
            measured.per_window(at),
            *measured.normal_equations(at, ("latency",)),
            *measured.normal_equations(at, ("latency",), 2),
        )
    for cores in (2, 3, 64):
        for one, other in zip(found[1], found[cores], strict=True):
            np.testing.assert_array_equal(one, other)
