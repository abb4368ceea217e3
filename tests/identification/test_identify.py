"""Identification: what was planted is found again, on the model's own flights; on real ones the
answer is the study's."""

import dataclasses
import itertools
from typing import Any

import jax
import numpy as np
import pytest

import planted
from maidenflight.errors import InputError
from maidenflight.flights.flight_csv import write as write_log
from maidenflight.flights.reading import read_flights
from maidenflight.identification import drone_file
from maidenflight.identification.drone_file import SAVED, Estimate
from maidenflight.identification.identify import identify
from maidenflight.identification.likelihood.flight_differences import trim_ensemble
from maidenflight.identification.likelihood.selection import FIRST
from maidenflight.identification.methods import Likelihood, Replay
from maidenflight.identification.outcome.bounds import bound_reached
from maidenflight.identification.outcome.estimates import note_doubts
from maidenflight.identification.outcome.problem import AUTO
from maidenflight.identification.outcome.progress import FITTING, Progress
from maidenflight.identification.posterior import Posterior
from maidenflight.identification.uncertainty import DESIGN
from maidenflight.identification.unknowns import PAPER_BOUNDS, physical_bounds
from maidenflight.parameters import QUANTITIES, check, crazyflie, replace, x_frame
from maidenflight.verbs.identify import Identify

FEW = Replay("bayesian", trials=1, evaluations=12)
QUICK = Replay("bayesian", trials=2, evaluations=14)
ONCE = Likelihood(trials=1)


@pytest.fixture(scope="module")
def flights():
    return planted.logs(planted.drone(1.9, 0.06, 0.012))


@pytest.fixture(scope="module")
def quick(flights):
    return identify(flights, QUICK, key=jax.random.key(5))


PLANTED = [(1.9, 0.06, 0.012), (1.7, 0.03, 0.004), (1.6, 0.11, 0.025)]


@pytest.mark.parametrize(
    ("method", "planted_xi"),
    [
        pytest.param("gradient", PLANTED[0], marks=pytest.mark.slow),
        *(pytest.param("gradient", one, marks=pytest.mark.night) for one in PLANTED[1:]),
        pytest.param("bayesian", PLANTED[2], marks=pytest.mark.night),
    ],
)
def test_a_planted_drone_is_found_again(planted_xi, method):
    """k_F within 1 %, T_m + latency within 3 ms, latency within 4 ms."""
    found = identify(planted.logs(planted.drone(*planted_xi)), Replay(method))
    thrust, lag, delay = (found.estimates[name].value for name in PAPER_BOUNDS)
    print(
        f"planted {planted_xi}: k_F {thrust / planted_xi[0] - 1:+.2%}, T_m + latency "
        f"{1e3 * (lag + delay - sum(planted_xi[1:])):+.2f} ms,",
        end=" ",
    )
    print(f"latency {1e3 * (delay - planted_xi[2]):+.2f} ms, loss {found.value:.3f}")
    assert thrust == pytest.approx(planted_xi[0], rel=0.01)
    assert lag + delay == pytest.approx(planted_xi[1] + planted_xi[2], abs=0.003)
    assert delay == pytest.approx(planted_xi[2], abs=0.004)


@pytest.mark.slow
def test_one_parameter_alone_is_found_and_the_others_are_kept(flights):
    """From one flight, of which the only block cannot be redrawn: a note must say so, lest an
    interval of no width be believed."""
    start = planted.drone(1.7, 0.06, 0.012)
    found = identify(flights[:1], FEW, over=["thrust_to_weight"], start=start)
    assert found.estimates["thrust_to_weight"].value == pytest.approx(1.9, rel=0.005)
    assert list(found.estimates) == ["thrust_to_weight"]
    for name in QUANTITIES:
        if name != "thrust_to_weight":
            np.testing.assert_array_equal(getattr(found.parameters, name), getattr(start, name))
    assert any("interval" in note for note in found.notes)


@pytest.mark.slow
def test_the_ensemble_of_an_identification_spreads_as_its_intervals_tell(quick):
    drones = quick.ensemble
    for name, estimate in quick.estimates.items():
        low, high = np.quantile(getattr(drones.drones, name), [0.025, 0.975])
        assert min(low, estimate.value) == pytest.approx(estimate.interval[0], rel=1e-4)
        assert max(high, estimate.value) == pytest.approx(estimate.interval[1], rel=1e-4)
    drawn = drones.draw(jax.random.key(3))
    values = np.stack([getattr(drones.drones, name) for name in quick.posterior], axis=1)
    assert np.any(
        np.all(values == np.stack([getattr(drawn, name) for name in quick.posterior]), axis=1)
    ), "one of them, whole"
    np.testing.assert_array_equal(drawn.mass, quick.parameters.mass)


@pytest.mark.slow
def test_an_estimate_lies_in_its_interval_and_in_its_parameters(quick):
    for name, estimate in quick.estimates.items():
        low, high = estimate.interval
        assert low <= estimate.value <= high
        assert getattr(quick.parameters, name) == np.float32(estimate.value)
    check(quick.parameters)


@pytest.mark.slow
def test_trials_are_the_optimisers_best_points(quick):
    for trial in (1, 2):
        rows = quick.search.filter(quick.search["trial"] == trial)
        best = rows.row(rows["objective"].arg_min(), named=True)
        for name, estimate in quick.estimates.items():
            assert estimate.trials[trial - 1] == pytest.approx(best[name])
    for estimate in quick.estimates.values():
        assert estimate.trial_mean == pytest.approx(np.mean(estimate.trials))
        assert estimate.trial_sd == pytest.approx(np.std(estimate.trials))


@pytest.mark.slow
def test_history_has_a_row_for_every_evaluation(quick):
    assert quick.search.columns == ["trial", *PAPER_BOUNDS, "objective"]
    assert len(quick.search) == quick.evaluations == 2 * 14 + 3 * DESIGN
    assert dict(quick.search["trial"].value_counts().iter_rows()) == {1: 14, 2: 14, 0: 3 * DESIGN}
    assert quick.search["objective"].min() == quick.value < quick.start_value


@pytest.mark.slow
def test_the_optimum_is_the_best_point_of_history(quick):
    best = quick.search.row(quick.search["objective"].arg_min(), named=True)
    for name, estimate in quick.estimates.items():
        assert estimate.value == pytest.approx(best[name])


@pytest.mark.night
def test_the_same_key_gives_the_same_result_and_another_key_another(flights, quick):
    again = identify(flights, QUICK, key=jax.random.key(5))
    other = identify(flights, QUICK, key=jax.random.key(6))
    assert again.drone_file().to_toml("one") == quick.drone_file().to_toml("one")
    assert again.search.equals(quick.search)
    assert not other.search.equals(quick.search)


@pytest.mark.slow
def test_an_identification_remembers_what_it_rests_on(quick, flights, tmp_path):
    assert dataclasses.asdict(quick.source) == {
        "flights": planted.FLIGHTS,
        "seconds": pytest.approx(sum(flight.duration for flight in flights), abs=0.01),
        "simulated": any(flight.simulated for flight in flights),
        "commands": "zero-order-hold",
        "full_scale_counts": 60000.0,
    }
    file = drone_file.read(quick.write(tmp_path / "drone.toml", {"seed": 5}))
    assert file.source == quick.source
    assert file.record == {"seed": 5}
    assert len(str(quick).splitlines()) == 1 + len(quick.estimates) + len(quick.notes)


def test_flights_whose_commands_mean_different_thrusts_are_refused(flights):
    mixed = [*flights[:2], dataclasses.replace(flights[2], full_scale_counts=65535.0)]
    with pytest.raises(
        InputError,
        match=r"stands for different counts of the firmware \(60000 in .*, 65535 in .*\)",
    ):
        identify(mixed)


def test_restless_samples_are_doubted(flights):
    sampled = [dataclasses.replace(flight, zero_order_hold=False) for flight in flights]
    (doubt,) = note_doubts({"actuator_noise": 0.14}, sampled)
    assert "lag and inertia cannot be trusted" in doubt
    assert (
        note_doubts({"actuator_noise": 0.14}, flights)
        == note_doubts({"actuator_noise": 0.03}, sampled)
        == note_doubts({}, sampled)
        == []
    )


def test_few_samples_of_commands_are_doubted(flights):
    slow = [dataclasses.replace(flight, period=0.02) for flight in flights]
    assert note_doubts({}, slow) == [], "each acts until the next"
    sampled = [dataclasses.replace(flight, zero_order_hold=False) for flight in slow]
    (doubt,) = note_doubts({}, sampled)
    assert "20 ms" in doubt
    assert len(note_doubts({"actuator_noise": 0.14}, sampled)) == 2


@pytest.mark.parametrize(
    ("settings", "module"),
    [
        (Replay(), "replay.replay.identified"),
        (Likelihood(), "likelihood.with_state.find"),
    ],
)
def test_logs_too_slow_for_the_lag_are_refused_before_the_fit(
    flights, settings, module, monkeypatch
):
    class Reached(Exception):
        pass

    def fit(*_):
        raise Reached

    monkeypatch.setattr(f"maidenflight.identification.{module}", fit)
    for rate in (100, 50, 40):
        with pytest.raises(Reached):
            identify([dataclasses.replace(flights[0], period=1 / rate)], settings)
    slow = dataclasses.replace(flights[1], period=0.1)
    with pytest.raises(InputError, match=r"planted 1: .*100 ms.*10 Hz"):
        identify([flights[0], slow], settings)


@pytest.mark.slow
def test_progress_is_counted_to_the_plan(flights):
    seen = []
    identify(flights, FEW, on_progress=seen.append)
    planned = 12 + 3 * DESIGN
    assert seen == [Progress(FITTING, done, planned, done) for done in range(1, planned + 1)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("bounds", "side"),
    [((1.5, 1.75), "1.75"), pytest.param((2.1, 2.5), "2.1", marks=pytest.mark.night)],
)
def test_an_optimum_at_a_search_bound_gives_a_note(flights, bounds, side):
    found = identify(
        flights,
        Replay(trials=1, evaluations=40),
        bounds={**PAPER_BOUNDS, "thrust_to_weight": bounds},
    )
    assert bound_reached("thrust_to_weight", found.estimates["thrust_to_weight"]) == float(side)
    assert any(f"thrust_to_weight = {side} lies at" in note for note in found.notes)


@pytest.mark.slow
def test_an_optimum_inside_its_bounds_gives_no_note(quick):
    assert quick.notes == ()


@pytest.mark.parametrize(
    ("over", "bounds", "words"),
    [
        (["k_F"], {}, "unknown parameter 'k_F'.*thrust_to_weight"),
        (["mass"], {}, "no search bounds for mass.*--bounds mass="),
        (["latency"], {"latency": (0.02, 0.01)}, "expected a rising pair"),
        (["latency"], {"latency": (0.01, 0.01)}, "expected a rising pair"),
        (["latency"], {"latency": (0.0, 0.06)}, r"within \[0, 0\.05\] s"),
        (["latency"], {"latency": (float("nan"), 0.05)}, "expected a rising pair"),
        (["inertia"], {"inertia": (1e-6, 1e-4)}, "unknown parameter 'inertia'.*inertia_x"),
        (["latency", "latency"], {}, "once"),
        ([], {}, "at least one"),
    ],
)
def test_what_cannot_be_searched_is_refused_in_words(flights, over, bounds, words):
    with pytest.raises(InputError, match=words):
        identify(flights, Replay(), over=over, bounds={**PAPER_BOUNDS, **bounds})


def test_a_start_with_another_drones_inertia_is_refused(flights):
    """A Crazyflie's, of 2 kg and with arms of 0.25 m."""
    heavy = replace(crazyflie(), mass=2.0, **x_frame(0.25))
    with pytest.raises(InputError, match=r"inertia 1\.33e-05, .*0\.0028 to 0\.21 kg m2"):
        identify(flights, start=heavy)


def test_too_little_flight_is_refused():
    with pytest.raises(InputError, match="no flights to identify from; give at least one"):
        identify([], Replay())


@pytest.mark.night
def test_a_third_of_the_real_pwm_flights_gives_the_studys_drone(shared_data):
    """Thrust and total lag of the throw-away study on these logs, from every third policy."""
    folders = sorted((shared_data / "authors" / "flights" / "pwm").iterdir())[::3]
    assert len(folders) == 12
    # Policies that crash within half a second leave a folder without a usable flight.
    flights = itertools.chain.from_iterable(usable(folder) for folder in folders)
    found = identify(flights, Replay(evaluations=25))
    thrust, lag, delay = (found.estimates[name].value for name in PAPER_BOUNDS)
    print(
        f"real: k_F {thrust:.3f}, T_m {1e3 * lag:.1f} ms, latency {1e3 * delay:.1f} ms, "
        f"{found.windows} windows, {found.seconds:.1f} s"
    )
    assert 1.45 < thrust < 1.60
    assert 0.085 < lag + delay < 0.102


def usable(folder):
    try:
        return read_flights(folder).flights
    except InputError:
        return ()


def test_of_a_large_folder_only_as_much_as_asked_for_reaches_the_identification(
    tmp_path, monkeypatch, flights
):
    class Reached(Exception):
        pass

    def seen(flights, *_, **__):
        raise Reached(flights.duration, flights.notes[:1])

    for number in range(3):
        write_log(tmp_path / f"{number}.csv", flights[number])
    monkeypatch.setattr("maidenflight.identification.identify.identify", seen)
    for most, duration, notes in ((3.1, 3.03, 1), (6.1, 6.0, 0)):
        verb = Identify(logs=tmp_path, lead_in=30, objective="replay")  # compiles nothing early
        object.__setattr__(verb, "most_seconds", most)  # less than the command line takes
        with pytest.raises(Reached) as reached:
            verb.run(tmp_path / "drone.toml")
        assert reached.value.args[0] == pytest.approx(duration)
        assert len(reached.value.args[1]) == notes


@pytest.fixture(scope="module")
def noisy(flights):
    return planted.with_noise(flights, seed=3)


@pytest.fixture(scope="module")
def likely(noisy):
    return identify(noisy, ONCE, over=FIRST, key=jax.random.key(5))


@pytest.mark.slow
def test_likelihood_is_the_objective_unless_told_otherwise(likely, quick):
    assert (likely.objective, quick.objective) == ("likelihood", "replay")
    assert likely.noise
    assert not quick.noise


@pytest.mark.slow
def test_a_most_likely_value_lies_in_its_interval_and_its_draws_within_bounds(likely, noisy):
    searched = physical_bounds(crazyflie())
    for name, estimate in likely.estimates.items():
        low, high = estimate.interval
        assert low <= estimate.value <= high
        assert getattr(likely.parameters, name) == np.float32(estimate.value)
        draws = likely.posterior[name]
        assert searched[name][0] <= draws.min() < draws.max() <= searched[name][1]
        assert len(np.unique(draws)) > 100
        assert estimate.valley is None
    check(likely.parameters)
    assert likely.windows == len(noisy), "two seconds have room for one"
    assert likely.search["objective"].min() == likely.value < likely.start_value
    assert len(likely.search) == likely.evaluations


@pytest.mark.slow
def test_a_parameter_at_a_bound_keeps_its_draws_within_it(noisy):
    bounds = {"thrust_to_weight": (1.5, 1.8)}
    found = identify(noisy, ONCE, over=["thrust_to_weight"], bounds=bounds)
    assert found.posterior["thrust_to_weight"].max() <= 1.8
    assert bound_reached("thrust_to_weight", found.estimates["thrust_to_weight"]) == 1.8


@pytest.mark.slow
def test_the_same_key_gives_the_same_likelihood_and_another_key_other_draws(noisy, likely):
    again = identify(noisy, ONCE, over=FIRST, key=jax.random.key(5))
    other = identify(noisy, ONCE, over=FIRST, key=jax.random.key(6))
    assert again.drone_file().to_toml("one") == likely.drone_file().to_toml("one")
    assert not np.array_equal(other.posterior["latency"], likely.posterior["latency"])
    assert other.value == likely.value, "the first trial begins at the start, whatever the key"


@pytest.mark.slow
def test_a_posterior_comes_back_from_its_file_as_drones_to_train_on(likely, tmp_path):
    file = drone_file.read(likely.write(tmp_path / "mine.toml"))
    assert list(file.posterior) == list(likely.posterior)
    back = file.ensemble
    for name, draws in likely.posterior.items():
        np.testing.assert_allclose(getattr(back.drones, name), draws[:SAVED], rtol=1e-5)
    np.testing.assert_array_equal(
        back.drones.inertia, np.tile(likely.parameters.inertia, (SAVED, 1))
    )
    drawn = jax.vmap(back.draw)(jax.random.split(jax.random.key(0), 500))
    rows = np.stack([getattr(drawn, name) for name in likely.posterior], axis=1)
    saved = np.stack([getattr(back.drones, name) for name in likely.posterior], axis=1)
    assert (rows[:, None] == saved[None]).all(axis=2).any(axis=1).all(), (
        "whole drones, values that belong together"
    )
    assert len(np.unique(rows, axis=0)) > SAVED / 2


def test_a_posterior_over_a_component_moves_that_component_alone():
    drones = (
        Posterior({"inertia_x": np.array([1e-5, 2e-5]), "latency": np.array([0.01, 0.02])})
        .ensemble(crazyflie())
        .drones
    )
    expected = np.array([[1e-5, 1.33e-5, 2.64e-5], [2e-5, 1.33e-5, 2.64e-5]], np.float32)
    np.testing.assert_array_equal(drones.inertia, expected)
    np.testing.assert_array_equal(drones.latency, np.array([0.01, 0.02], np.float32))


@pytest.mark.parametrize(
    ("samples", "words"),
    [({}, "posterior"), ({"latency": np.array([0.01, 0.06])}, r"2: latency = 0\.06")],
)
def test_samples_that_are_missing_or_no_drones_are_refused(samples, words):
    with pytest.raises(InputError, match=rf"mine\.toml.*{words}"):
        Posterior(samples).ensemble(crazyflie(), "mine.toml")


def test_parameters_are_chosen_by_likelihood_only(flights):
    with pytest.raises(InputError, match="chosen by likelihood only"):
        identify(flights, Replay(), over=AUTO)


def test_settings_of_no_method_are_refused(flights):
    settings: Any = "least squares"
    with pytest.raises(InputError, match="least squares"):
        identify(flights, settings)


@pytest.mark.parametrize("wrong", [{"trials": 0}, {"evaluations": -1}, {"lead_in": -1}])
@pytest.mark.parametrize("settings", [Likelihood, Replay])
def test_settings_that_make_no_sense_are_refused_by_name(settings, wrong):
    with pytest.raises(InputError, match=f"{settings.__name__}.{next(iter(wrong))}"):
        settings(**wrong)


def test_only_a_replay_may_begin_at_rest():
    assert Replay(lead_in=0).lead_in == 0
    with pytest.raises(InputError, match=r"Likelihood.lead_in"):
        Likelihood(lead_in=0)


def test_trims_differ_as_they_did_between_flights_and_nothing_else_does() -> None:
    drone = replace(crazyflie(), torque_bias=np.array([0.0, 1e-4, 2e-5], np.float32))
    estimates = {
        "torque_bias_y": Estimate(1e-4, (0.0, 2e-4), (1e-4,), 5e-5),
        "torque_bias_z": Estimate(2e-5, (0.0, 4e-5), (2e-5,), 4e-5),
        "latency": Estimate(0.01, (0.0, 0.02), (0.01,), 1.0),
    }
    drones = trim_ensemble(drone, estimates, "mine.toml").drones
    np.testing.assert_allclose(np.mean(drones.torque_bias, axis=0), drone.torque_bias, atol=1e-6)
    np.testing.assert_allclose(
        np.std(drones.torque_bias, axis=0), [0.0, 5e-5, 4e-5], rtol=0.05, atol=1e-12
    )
    correlation = np.corrcoef(
        np.asarray(drones.torque_bias)[:, 1], np.asarray(drones.torque_bias)[:, 2]
    )[0, 1]
    assert abs(correlation) < 0.1
    np.testing.assert_array_equal(drones.latency, np.full(256, drone.latency))


@pytest.mark.parametrize("estimates", [{}, {"latency": Estimate(0.01, (0.0, 0.02), (0.01,), 0.1)}])
def test_a_drone_whose_trims_were_not_identified_is_refused(estimates) -> None:
    with pytest.raises(InputError, match=r"mine\.toml.*trims"):
        trim_ensemble(crazyflie(), estimates, "mine.toml")
