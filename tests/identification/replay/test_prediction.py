import dataclasses
from functools import partial

import jax
import numpy as np
import pytest

import planted
from maidenflight.errors import InputError
from maidenflight.flights.windows import windows
from maidenflight.identification.replay import open_loop, prediction
from maidenflight.identification.replay.open_loop import simulate
from maidenflight.identification.replay.prediction import (
    ERROR_UNITS,
    LOGGED,
    PERSISTENCE,
    predicted_windows,
    prediction_error,
    with_own_trim,
)
from maidenflight.parameters import replace

TRUE = planted.drone(1.8, 0.07, 0.012)
WRONG = planted.drone(1.7, 0.09, 0.012)
COLUMNS = list(ERROR_UNITS)


@pytest.fixture(scope="module")
def flights():
    return planted.logs(TRUE, count=5)


@pytest.fixture(scope="module")
def table(flights):
    return prediction_error(flights, {"true": TRUE, "wrong": WRONG})


def errors(table, model):
    """Horizons x quantities."""
    return table.filter(table["model"] == model).select(COLUMNS).to_numpy()


def test_a_row_for_each_model_and_horizon(table):
    assert table["model"].to_list() == ["true", "wrong", PERSISTENCE] * 3
    assert table["horizon"].to_list() == [0.02] * 3 + [0.05] * 3 + [0.1] * 3
    assert set(table["windows"]) == {5 * 16}
    assert set(table["segments"]) == {5}


def test_the_model_that_made_the_data_predicts_it(table):
    assert np.all(errors(table, "true") < 0.02 * errors(table, PERSISTENCE))
    assert np.all(errors(table, "true") < 2e-3)
    assert np.all(errors(table, PERSISTENCE) > 5e-3)


def test_a_drone_with_each_flights_own_trim_predicts_flights_of_several_trims():
    torques = [(0.0, 0.0, 0.0), (6e-5, -3e-5, 0.0)]
    each = [replace(TRUE, torque_bias=np.array(torque, np.float32)) for torque in torques]
    flown = [
        dataclasses.replace(flight, name=f"{number}")
        for number, drone in enumerate(each)
        for flight in planted.logs(drone, count=1)
    ]
    drones = [with_own_trim(TRUE, [flight]) for flight in flown]
    for drone, truth in zip(drones, each, strict=True):
        np.testing.assert_allclose(drone.torque_bias, truth.torque_bias, atol=1e-5)
    models = {"same": TRUE, "own": partial(with_own_trim, TRUE)}
    rates = [errors(prediction_error(flown, models), name)[:, 3] for name in models]
    assert np.all(rates[1] < 0.2 * rates[0])


def test_errors_of_a_wrong_model_grow_with_the_horizon(table):
    assert np.all(np.diff(errors(table, "wrong")[:, :3], axis=0) > 0)
    assert np.all(errors(table, "wrong") > 2 * errors(table, "true"))


def test_intervals_hold_their_value_and_come_from_the_key(table, flights):
    for column in COLUMNS:
        low, value, high = (table[column + end].to_numpy() for end in ("_low", "", "_high"))
        assert np.all((low >= 0) & (low <= value) & (value <= high))
        assert np.all((low < high)[table["model"].to_numpy() == PERSISTENCE])
    again = [
        prediction_error(flights, {}, key=key)
        for key in (None, jax.random.key(0), jax.random.key(1))
    ]
    assert again[0].equals(again[1])
    assert not again[0].equals(again[2])
    assert again[0].select(COLUMNS).equals(again[2].select(COLUMNS))
    alone = prediction_error(flights[:1], {})
    assert alone["position_low"].to_numpy() == pytest.approx(alone["position"].to_numpy())


@pytest.mark.slow
def test_entries_are_those_of_a_plain_loop_over_windows(flights):
    table = prediction_error(flights[:1], {"wrong": WRONG}, [0.5, 0.1])
    cut = windows(flights[:1], 50)
    drone = jax.tree.map(jax.numpy.asarray, replace(WRONG, time_step=np.float32(0.005)))
    alone = jax.jit(lambda window: simulate(window, drone, 2))
    for place, row in enumerate((10, 50)):
        squares = {name: [] for name in ("wrong", PERSISTENCE)}
        for number in range(len(cut.segment)):
            window = jax.tree.map(lambda array, number=number: array[number], cut)
            measured = window.measured[row - 1].astype(np.float64)
            begin = 30 + 10 * number
            start = [
                getattr(flights[0], name)[begin]
                for name in ("position", "velocity", "attitude", "body_rates")
            ]
            for name, said in (
                ("wrong", np.asarray(alone(window))[row - 1]),
                (PERSISTENCE, np.concatenate(start)),
            ):
                turn = rotation(said[6:9]).T @ rotation(measured[6:9])
                angle = np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))
                parts = [
                    np.linalg.norm(said[part] - measured[part])
                    for part in (slice(0, 3), slice(3, 6), slice(9, 12))
                ]
                squares[name].append(np.square([*parts[:2], angle, parts[2]]))
        for name, values in squares.items():
            np.testing.assert_allclose(
                errors(table, name)[place], np.sqrt(np.mean(values, axis=0)), rtol=1e-4, atol=1e-6
            )


def rotation(attitude):
    """Rz(yaw) Ry(pitch) Rx(roll)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(attitude.astype(float)), np.sin(attitude.astype(float))
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def test_angles_wrap(flights):
    """A heading of 180 deg puts yaw on both sides of the jump, and changes no error of the
    attitude."""
    turned = []
    for flight in flights[:2]:
        attitude = flight.attitude.copy()
        attitude[:, 2] = (attitude[:, 2] + 2 * np.pi) % (2 * np.pi) - np.pi
        turned.append(dataclasses.replace(flight, attitude=attitude))
    assert np.abs(np.diff(turned[0].attitude[:, 2])).max() > 6
    for name, tolerance in (("true", 1e-4), (PERSISTENCE, 1e-5)):
        before, after = (
            errors(prediction_error(some, {"true": TRUE}), name)[:, 2]
            for some in (flights[:2], turned)
        )
        np.testing.assert_allclose(after, before, atol=tolerance)


def test_a_horizon_is_taken_to_the_nearest_row(flights):
    assert prediction_error(flights[:1], {}, [0.1049, 0.006])["horizon"].to_list() == [0.01, 0.1]


@pytest.mark.parametrize(
    ("horizons", "says"),
    [
        ([], "horizons: none"),
        ([0.0], "horizons: 0;"),
        ([0.1, -0.2], "at least a row"),
        ([float("nan")], "in seconds"),
        ([float("inf")], "in seconds"),
        ([0.1, 0.101], "on one row"),
        ([0.1, 2.0], "no flight is long enough"),
    ],
)
def test_horizons_that_make_no_sense_are_refused(flights, horizons, says):
    with pytest.raises(InputError, match=says):
        prediction_error(flights, {}, horizons)


def test_other_input_that_makes_no_sense_is_refused(flights):
    with pytest.raises(InputError, match="no flights"):
        prediction_error([], {})
    with pytest.raises(InputError, match="rename"):
        prediction_error(flights, {PERSISTENCE: TRUE})
    with pytest.raises(InputError, match="quick: its simulation diverges"):
        prediction_error(
            flights,
            {"true": TRUE, "quick": replace(TRUE, drag=np.full(3, 1e4, np.float32))},
            [0.5],
        )
    with pytest.raises(InputError, match="different rates"):
        prediction_error([flights[0], dataclasses.replace(flights[1], period=0.02)], {})


@pytest.mark.slow
def test_chunks_are_filled_and_cut(flights):
    cut = windows(flights * 5, 5)
    assert len(cut.segment) > open_loop.CHUNK
    said = prediction.predict(cut, TRUE, 0.01)
    assert said.shape == (len(cut.segment), 5, 12)
    few = jax.tree.map(lambda array: array[-3:], cut)
    np.testing.assert_allclose(said[-3:], prediction.predict(few, TRUE, 0.01), atol=1e-6)


def test_windows_to_look_at_are_the_logs_and_the_models_own(flights):
    table = predicted_windows(
        flights, {"true": TRUE, "wrong": WRONG}, 0.25, 4, key=jax.random.key(3)
    )
    assert table["model"].unique(maintain_order=True).to_list() == [LOGGED, "true", "wrong"]
    assert table["flight"].n_unique() == 4, "each from another flight"
    assert table.height == 4 * 3 * 26
    for (_, model), rows in table.group_by("window", "model"):
        flight = next(flight for flight in flights if flight.name == rows["flight"][0])
        first = round(rows["start"][0] / flight.period)
        logged = np.concatenate(
            [flight.position, flight.velocity, flight.attitude, flight.body_rates], axis=1
        )[first : first + 26]
        told = rows.select(
            "position_x", "position_y", "position_z", "roll", "pitch", "yaw"
        ).to_numpy()
        far = np.abs(told - logged[:, [0, 1, 2, 6, 7, 8]])
        assert far[0].max() < 1e-6
        assert (far.max() < 2e-3) == (model != "wrong")


def test_windows_to_look_at_follow_from_the_key_and_come_from_all_flights_again(flights):
    one, same, other = (
        predicted_windows(flights[:2], {}, 0.25, 5, key=jax.random.key(seed)) for seed in (1, 1, 2)
    )
    assert one.equals(same)
    assert not one.equals(other)
    assert one.select("flight", "start").n_unique() == 5
    assert one["flight"].n_unique() == 2


def test_windows_to_look_at_that_cannot_be_are_refused(flights):
    with pytest.raises(InputError, match="rename it"):
        predicted_windows(flights, {LOGGED: TRUE})
    with pytest.raises(InputError, match="at least one"):
        predicted_windows([], {})
    with pytest.raises(InputError, match="long enough"):
        predicted_windows(flights, {}, 60.0)
