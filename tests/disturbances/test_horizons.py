"""Estimated disturbances, and errors by time ahead."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from made_flights import calm
from maidenflight.disturbances import fitting, horizons
from maidenflight.disturbances.fitting import DisturbanceModel, filter_flights, start_processes
from maidenflight.disturbances.kalman import gains, scale_variance
from maidenflight.disturbances.motion import advance, hover, regulator
from maidenflight.disturbances.rows import STRETCH, hover_speed, stretches
from maidenflight.errors import InputError
from maidenflight.flights.log import flight_of
from maidenflight.parameters import crazyflie, replace

PERIOD = 0.01
TORQUE = np.array([1.5, -1.0, 0.4])
"""Over inertia [rad/s2]."""
DRONE = jax.tree.map(lambda one: np.asarray(one, float), crazyflie())


def fly(demand):
    """A flight on which a constant torque acts, held by a regulator, with measured speeds."""
    generator = np.random.default_rng(0)
    with jax.enable_x64(True):
        motion, speed = hover(DRONE)
        motion = motion._replace(slow=motion.slow._replace(trim=jnp.asarray(TORQUE)))
        processes = start_processes()._replace(trim_time=np.full(3, 1e9))
        inertia = np.asarray(DRONE.inertia, float)
        levers = np.stack(
            [DRONE.rotor_y, -DRONE.rotor_x, DRONE.torque_to_thrust * DRONE.rotor_direction]
        )
        mixer = np.linalg.pinv(np.concatenate([levers, np.ones((1, 4))]))
        weight = float(DRONE.mass * DRONE.gravity)
        full = weight / 4 * float(DRONE.thrust_to_weight)
        step = jax.jit(lambda now, speed: advance(now, speed, DRONE, processes, PERIOD))
        wanted = jax.jit(lambda now: regulator(now, processes))
        rows = []
        for now in demand:
            turning = np.asarray(wanted(motion)) + generator.normal(0, 2.0, 3) + now
            asked = (turning - TORQUE) * inertia
            speed = np.sqrt(np.maximum(mixer @ [*asked, weight], 0.0) / full)
            rows.append([*map(np.asarray, motion[:4]), speed])
            motion = step(motion, jnp.asarray(speed))
    position, velocity, quaternion, rates, speeds = map(np.stack, zip(*rows, strict=True))
    return flight_of(
        "planted",
        PERIOD,
        position=position,
        velocity=velocity + generator.normal(0, 0.01, (700, 3)),
        attitude=Rotation.from_quat(quaternion).as_euler("ZYX")[:, ::-1],
        body_rates=rates + generator.normal(0, 0.02, (700, 3)),
        command=speeds**2,
        rotor_speed=speeds * 2000.0,
        zero_order_hold=True,
    )


@pytest.fixture(scope="module")
def planted():
    return fly(np.zeros((700, 3)))


def model(flight, **changes):
    processes = start_processes()._replace(speed_delay=np.array(0.005), **changes)
    return DisturbanceModel(DRONE, processes, hover_speed([flight]))


@pytest.mark.slow
def test_a_constant_torque_is_found(planted):
    (found,) = filter_flights([planted], model(planted))
    assert len(found.torque) == len(planted)
    torque = np.asarray(DRONE.inertia, float) * TORQUE
    error = found.torque[200:].mean(axis=0) - torque
    assert np.all(np.abs(error) < 0.15 * np.abs(torque).max())
    assert np.all(np.linalg.eigvalsh(found.torque_covariance) > 0.0)
    assert np.allclose(found.velocity[200:], planted.velocity[200:], atol=0.08)


@pytest.mark.slow
def test_a_velocity_that_is_logged_too_large_is_taken_for_what_it_is(planted):
    logged = dataclasses.replace(planted, velocity=1.2 * planted.velocity)
    known, unknown = (
        filter_flights([logged], model(planted, velocity_scale=np.full(3, scale)))[0].velocity
        for scale in (1.2, 1.0)
    )
    (right,) = filter_flights([planted], model(planted))
    off = [np.abs(one[200:] - right.velocity[200:]).mean() for one in (known, unknown)]
    assert off[0] < 0.2 * off[1]


@pytest.mark.slow
def test_a_thrust_that_is_fitted_acts_when_flights_are_read_again(planted, monkeypatch):
    """A tenth more of it at the same speeds lifts by a tenth of the weight, unless air pushes."""

    def maximise(parts, starts, start, *_):
        stronger = replace(start, thrust_to_weight=1.1 * start.thrust_to_weight)
        return stronger, model(planted, push_size=np.full(3, 1.0)).processes

    monkeypatch.setattr(fitting, "_maximise", maximise)
    found = fitting.fit_disturbances([planted], DRONE)
    (filtered,) = filter_flights([planted], found)
    weight = float(DRONE.mass * DRONE.gravity)
    assert filtered.force[200:, 2].mean() == pytest.approx(-0.1 * weight, rel=0.15)


@pytest.fixture(scope="module")
def demanding():
    """A flight whose regulator wants a Gauss-Markov 10 rad/s2."""
    kicks = np.random.default_rng(1).normal(0, 10.0 * np.sqrt(1 - np.exp(-0.04)), (700, 3))
    return fly(lfilter([1.0], [1.0, -np.exp(-0.02)], kicks, axis=0))


def predict(flight):
    """Returns norms of errors, by a model of a sixteenth of that demand."""
    little = model(flight, demand_size=np.full(3, 10.0 / 16))
    predictions = horizons.predict_windows([flight], little, DRONE, every=7)
    return predictions.norms[horizons.WITH_DISTURBANCES]


@pytest.mark.slow
def test_a_regulator_that_wants_more_than_was_fitted_is_followed(planted, demanding, monkeypatch):
    chosen, calm_chosen = predict(demanding), predict(planted)
    monkeypatch.setattr(horizons, "DEMANDS", (horizons.DEMANDS[0],) * len(horizons.DEMANDS))
    fitted, calm_fitted = predict(demanding), predict(planted)
    assert np.all(chosen[..., 2:].mean(axis=(0, 1)) < 0.9 * fitted[..., 2:].mean(axis=(0, 1)))
    assert np.allclose(calm_chosen.mean(axis=(0, 1)), calm_fitted.mean(axis=(0, 1)), rtol=0.1)


@pytest.mark.slow
def test_later_rows_change_no_earlier_prediction(planted, demanding):
    """From row 60 on another's turns are logged, ten times as fast."""
    turns = planted.body_rates.copy()
    turns[60:] = 10.0 * demanding.body_rates[60:]
    norms, changed = predict(planted), predict(dataclasses.replace(planted, body_rates=turns))
    starts = np.arange(35, 649, 7)
    is_before = starts + np.arange(1, 51)[:, None] < 60
    assert norms.shape[:2] == is_before.shape
    assert np.array_equal(norms[is_before], changed[is_before])
    assert not np.allclose(norms[~is_before], changed[~is_before])


def test_a_window_is_predicted_by_what_told_those_that_ended_before_it():
    density = np.array([[0.0, 0.0, 0.0, 0.0, 9.0], [1.0, -3.0, 0.0, 0.0, 0.0]])
    flight, row = np.array([0, 0, 0, 0, 1]), np.array([30, 40, 80, 90, 90])
    assert list(horizons._best_before(density, flight, row, 50)) == [0, 0, 1, 0, 0]


@pytest.fixture(scope="module")
def table(planted):
    predictions = horizons.predict_windows([planted], model(planted), DRONE, every=7)
    return horizons.tabulate_horizons([predictions])


@pytest.mark.slow
def test_predictions_with_the_torque_beat_those_without(table):
    sums = {row["model"]: row for row in table.filter(horizon=horizons.SUMS).to_dicts()}
    ours, alone = sums[horizons.WITH_DISTURBANCES], sums[horizons.ALONE]
    for name in ("attitude", "body_rates", "velocity"):
        assert ours[name] < 0.5 * alone[name]
        assert ours[name] < sums[horizons.PERSISTENCE][name]
    assert 0.5 <= ours["attitude_within_80"] <= ours["attitude_within_95"] <= 1.0
    assert np.isnan(alone["attitude_within_80"])
    assert len(table) == 4 * 51


@pytest.mark.slow
def test_sums_add_up_and_baselines_need_no_model(planted, table):
    for (name,), rows in table.group_by("model"):
        ahead, total = rows.filter(rows["horizon"] > 0), rows.filter(rows["horizon"] == 0)
        assert np.isclose(ahead["velocity"].sum(), total["velocity"][0]), name
    starts = np.arange(len(planted))
    starts = starts[(starts >= 30) & (starts % 7 == 0) & (starts + 50 < len(planted))]
    change = np.linalg.norm(planted.body_rates[starts + 10] - planted.body_rates[starts], axis=1)
    rows = table.filter(model=horizons.CONSTANT_RATES, horizon=0.1).to_dicts()
    assert rows[0]["windows"] == len(starts)
    assert np.isclose(rows[0]["body_rates"], change.mean())


def test_windows_lie_within_one_flight_and_count_once():
    flights = [calm(STRETCH + 500), calm(90, seed=1)]
    parts = stretches(flights, DRONE)
    stretch, row = parts.starts(50)
    places = list(zip(parts.flight[stretch], parts.first[stretch] + row, strict=True))
    expected = [(0, one) for one in range(30, STRETCH + 450)] + [(1, one) for one in range(30, 40)]
    assert sorted(places) == expected


AHEAD = 50
"""Rows."""


@jax.jit
def compute_gains(drone, processes):
    return gains(drone, processes, PERIOD, AHEAD)


def test_doubt_grows_with_time_and_with_disturbances():
    with jax.enable_x64(True):
        small = compute_gains(DRONE, start_processes())
        large = compute_gains(DRONE, start_processes()._replace(gust_size=np.full(3, 20.0)))
    assert np.all(np.diff(small.variance[:, 6:9], axis=0) > 0.0)
    assert np.all(large.variance[:, 6:9] > small.variance[:, 6:9])
    assert np.all(np.linalg.eigvalsh(small.covariance) > -1e-12)


def test_bands_scale_with_their_core_and_gains_do_not():
    processes = start_processes()
    half = processes._replace(core=processes.core * np.array([1.0, 0.5, 1.0, 1.0]))
    with jax.enable_x64(True):
        every, same = compute_gains(DRONE, processes), compute_gains(DRONE, half)
        unrest = jnp.full((2, AHEAD), 3.0)
        scaled = [scale_variance(every, unrest, now) for now in (processes, half)]
        bands, narrow = map(np.asarray, scaled)
    assert np.array_equal(every.filtering, same.filtering)
    assert np.allclose(narrow[..., 3:6], 0.5 * bands[..., 3:6])
    assert np.array_equal(np.delete(narrow, np.s_[3:6], -1), np.delete(bands, np.s_[3:6], -1))


@pytest.mark.slow
def test_a_fit_makes_flights_likelier_and_keeps_numbers_possible(planted, monkeypatch):
    monkeypatch.setattr(fitting, "_ITERATIONS", 3)
    monkeypatch.setattr(fitting, "_WINDOWS", 40)
    begin = replace(DRONE, drag=np.array([0.5, 0.5, 0.2]))
    counts = []
    found = fitting.fit_disturbances([planted], begin, lambda done, of: counts.append(done / of))
    assert counts[0] > 0.0
    assert counts == sorted(counts)
    for value in (*found.processes, found.drone.thrust_to_weight, found.drone.drag):
        assert np.all(np.isfinite(value))
        assert np.all(np.asarray(value) > 0.0)
    share = begin.thrust_to_weight / found.drone.thrust_to_weight
    carrying = hover_speed([planted]) * np.sqrt(share)
    assert found.carrying_speed == pytest.approx(carrying, rel=1e-4)


def test_densities_integrate_to_one():
    error = np.linspace(-60.0, 60.0, 20001)
    density = np.exp(fitting.log_density(error, 0.3, 3.0))
    assert np.trapezoid(density, error) == pytest.approx(1.0, abs=1e-3)


def test_flights_too_short_or_without_state_are_refused():
    short = calm(60)
    with pytest.raises(InputError):
        horizons.predict_windows(
            [short],
            model(short)
            if short.rotor_speed is not None
            else DisturbanceModel(DRONE, start_processes(), None),
            DRONE,
        )
    bare = dataclasses.replace(
        calm(200),
        position=np.full((200, 3), np.nan, np.float32),
        accelerometer=np.zeros((200, 3), np.float32),
    )
    with pytest.raises(InputError):
        stretches([bare], DRONE)
