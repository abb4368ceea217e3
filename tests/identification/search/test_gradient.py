"""Identification by gradients: the derivatives are the objective's, and every start ends where
Bayesian optimisation does."""

import jax
import numpy as np
import pytest

import planted
from maidenflight.errors import InputError
from maidenflight.flights.windows import windows
from maidenflight.identification.identify import identify
from maidenflight.identification.methods import Replay
from maidenflight.identification.replay.objective import Objective
from maidenflight.identification.search import bayesian, gradient
from maidenflight.identification.search.gauss_newton import NormalEquations, in_unit_cube
from maidenflight.identification.unknowns import PAPER_BOUNDS, Box
from maidenflight.parameters import crazyflie, noiseless, replace

TRUTH = np.array([1.9, 0.06, 0.012])
BESIDE = {"thrust_to_weight": 1.82, "motor_time_constant": 0.05, "latency": 0.0083}
NAMES = tuple(PAPER_BOUNDS)
BOX = Box(NAMES, *zip(*PAPER_BOUNDS.values(), strict=True))


@pytest.fixture(scope="module")
def flights():
    """Forty seconds of a planted drone whose measured rates are noisy, so that nothing fits without
    error."""
    generator = np.random.default_rng(1)
    flown = planted.logs(planted.drone(*TRUTH), 20)
    for flight in flown:
        noisy = flight.body_rates + generator.normal(0, 0.05, flight.body_rates.shape).astype(
            np.float32
        )
        object.__setattr__(flight, "body_rates", noisy)
    return flown


@pytest.fixture(scope="module")
def objective(flights):
    return Objective(windows(flights, planted.LENGTH), 0.01)


def drone(unit):
    return replace(
        noiseless(crazyflie()), **dict(zip(NAMES, BOX.values(unit).astype(np.float32), strict=True))
    )


def search(objective, seed, box=BOX):
    def at(unit):
        return replace(
            noiseless(crazyflie()),
            **dict(zip(NAMES, box.values(unit).astype(np.float32), strict=True)),
        )

    def equations(unit, every):
        return in_unit_cube(objective.normal_equations(at(unit), NAMES, every), box, unit)

    kinks = gradient.kinks(box, objective.period)
    return gradient.minimise(
        lambda unit: objective(at(unit)),
        equations,
        objective.size,
        kinks,
        30,
        np.random.default_rng(seed),
    )


@pytest.mark.slow
def test_the_loss_of_the_normal_equations_is_the_objective(objective):
    at = planted.drone(**BESIDE)
    assert objective.normal_equations(at, NAMES).loss == pytest.approx(objective(at), rel=1e-5)


@pytest.mark.slow
def test_a_share_of_the_windows_is_each_so_manieth(objective):
    at = planted.drone(**BESIDE)
    assert objective.normal_equations(at, NAMES, 3).loss == pytest.approx(
        objective.per_window(at)[::3].mean(), rel=1e-5
    )


@pytest.mark.parametrize(("number", "step"), [(0, 2e-3), (1, 2e-4), (2, 1e-4)])
@pytest.mark.slow
def test_the_gradient_is_that_of_central_differences(objective, number, step):
    name = NAMES[number]
    sides = [
        objective(planted.drone(**{**BESIDE, name: BESIDE[name] + side * step})) for side in (-1, 1)
    ]
    found = objective.normal_equations(planted.drone(**BESIDE), NAMES).gradient[number]
    assert found == pytest.approx((sides[1] - sides[0]) / (2 * step), rel=0.01)


@pytest.mark.slow
def test_both_models_of_the_curvature_are_symmetric_and_positive_and_one_is_the_larger(objective):
    found = objective.normal_equations(planted.drone(**BESIDE), NAMES)
    scale = np.sqrt(np.diag(found.majorant))
    for matrix in (found.curvature, found.majorant, found.majorant - found.curvature):
        scaled = matrix / np.outer(scale, scale)
        np.testing.assert_allclose(scaled, scaled.T, atol=1e-5)
        assert np.linalg.eigvalsh(scaled).min() > -1e-4


@pytest.mark.slow
def test_the_unit_cubes_gradient_is_that_of_central_differences(objective):
    unit = BOX.unit(np.array(list(BESIDE.values())))
    found = in_unit_cube(objective.normal_equations(drone(unit), NAMES), BOX, unit).gradient
    shifts = 2e-3 * np.eye(3)
    expected = [
        (objective(drone(unit + shift)) - objective(drone(unit - shift))) / 4e-3 for shift in shifts
    ]
    np.testing.assert_allclose(found, expected, rtol=0.02)


@pytest.mark.slow
def test_five_starts_end_at_one_optimum_no_higher_than_the_bayesian_one(objective):
    """The objectives within 0.5 %, for near an exact fit they rise like a cone; no more than 8
    evaluations on all windows."""
    runs = [search(objective, seed) for seed in range(5)]
    lowest = np.array([losses.min() for _, losses in runs])
    optima = np.array([points[np.argmin(losses)] for points, losses in runs])
    _, reference = bayesian.minimise(
        lambda unit: objective(drone(unit)), 3, 60, np.random.default_rng(0)
    )
    print(
        f"gradient {lowest}, Bayesian {reference.min()}, {[len(losses) for _, losses in runs]} "
        f"evaluations, {BOX.values(optima)}"
    )
    assert (lowest <= reference.min() * (1 + 1e-5)).all()
    np.testing.assert_allclose(lowest, lowest.min(), rtol=5e-3)
    np.testing.assert_allclose(optima, np.broadcast_to(optima[0], optima.shape), atol=0.01)
    assert max(len(losses) for _, losses in runs) <= 8


def test_the_search_goes_into_a_kink_and_onto_a_face_in_few_evaluations():
    """Two parameters curve a valley, a kink in the latency lies where it would otherwise go on, and
    thrust is best at the face."""
    matrix = np.array([[3.0, -0.5, 0.0], [-0.5, 1.2, 0.3], [0.0, 0.3, 0.2]])
    slope, kink = np.array([0.5, 0.0, 0.004]), 0.1
    middle = np.array([0.0, 0.55, 0.13])

    def value(point):
        shift = point - middle
        return (
            1.0 + slope[:2] @ point[:2] + shift @ matrix @ shift / 2 + 0.02 * abs(point[2] - kink)
        )

    def equations(point, every):
        gradient_there = np.array([*slope[:2], 0.02 * np.sign(point[2] - kink)]) + matrix @ (
            point - middle
        )
        # Twice the true curvature, as where what the method of Gauss and Newton leaves out is
        # large.
        return NormalEquations(value(point), gradient_there, 2 * matrix, 4 * matrix)

    for seed in range(5):
        kinks = [np.empty(0), np.empty(0), np.arange(11) / 10]
        points, losses = gradient.minimise(
            value, equations, 1000, kinks, 30, np.random.default_rng(seed)
        )
        exact = np.array([0.0, 0.55 - 0.3 * (kink - 0.13) / 1.2, kink])
        assert losses.min() < value(exact) + 1e-5
        np.testing.assert_allclose(points[np.argmin(losses)], exact, atol=5e-3)
        assert len(losses) <= 8


def test_a_step_ends_behind_the_next_kink_and_does_not_go_back_across_one_it_came_over():
    kinks = [np.array([0.1, 0.2, 0.3])]
    low, high = gradient.cell(kinks, np.array([0.25]), np.array([0.25]))
    assert low < 0.2 < low + 1e-5
    assert high > 0.3 > high - 1e-5
    behind = low
    assert gradient.cell(kinks, behind, np.array([0.25]))[1] < 0.21
    assert gradient.cell(kinks, behind, behind)[1] > 0.3
    assert gradient.cell(kinks, behind, behind)[0] == pytest.approx(0.1, abs=1e-5)


def test_kinks_lie_at_latencies_of_whole_command_periods():
    found = gradient.kinks(Box(("thrust_to_weight", "latency"), (1.5, 0.002), (2.5, 0.012)), 0.005)
    assert len(found[0]) == 0
    np.testing.assert_allclose(found[1], [0.3, 0.8])


@pytest.mark.slow
def test_the_box_is_never_left_and_an_optimum_outside_is_met_at_its_face(objective):
    box = Box(NAMES, (1.5, 0.01, 0.0), (1.7, 0.5, 0.05))
    points, losses = search(objective, 1, box)
    assert ((points >= 0) & (points <= 1)).all()
    assert points[np.argmin(losses)][0] > 0.999


@pytest.mark.night
def test_trials_by_gradients_end_at_the_planted_drone(flights):
    seen = []
    found = identify(
        flights,
        Replay(),
        key=jax.random.key(2),
        on_progress=seen.append,
    )
    for name, truth in zip(NAMES, TRUTH, strict=True):
        assert found.estimates[name].value == pytest.approx(truth, rel=0.05)
        assert np.ptp(found.estimates[name].trials) < 0.02 * truth
    assert seen[-1].evaluations == found.evaluations == len(found.search)


def test_a_replay_follows_gradients_unless_told_otherwise():
    assert Replay().method == "gradient"


def test_an_unknown_method_is_refused_in_words():
    with pytest.raises(InputError, match=r"unknown method 'newton'.*gradient, bayesian"):
        Replay("newton")
