"""What logs hold, against numbers that are put in."""

import numpy as np
import pytest

from made_flights import calm
from maidenflight.flights.log import TORQUES
from maidenflight.flights.summary import choose_most_telling, rank, summaries


def test_pieces_of_one_log_are_summed_and_only_what_was_measured_is_a_signal():
    unknown = np.full((120, 3), np.nan, np.float32)
    state = calm(name="a", zero_order_hold=False)
    alone = calm(
        name="b",
        position=unknown,
        velocity=unknown,
        attitude=unknown,
        battery=np.full(120, np.nan),
        accelerometer=np.tile(np.array([0.0, 0.0, 9.81], np.float32), (120, 1)),
    )
    first, second = summaries([state, alone, state])
    assert (first.name, first.pieces, first.seconds, first.rate) == ("a", 2, 2.4, 100.0)
    assert {"position", "velocity", "attitude", "body_rates"} <= set(first.signals)
    assert (second.name, second.pieces) == ("b", 1)
    assert {"body_rates", "accelerometer"} <= set(second.signals)
    assert not {"position", "velocity", "attitude", "battery", "rotor_speed"} & set(second.signals)
    assert (second.speed, second.tilt, second.battery) == (None, None, None)
    assert (first.commands, second.commands) == ("subsampled", "zero-order-hold")


def test_spreads_are_those_of_the_commands():
    wave = 0.1 * np.sin(np.arange(120) * np.pi / 6)
    together = 0.5 + np.tile(wave[:, None], 4)
    rolling = 0.5 + wave[:, None] * [-1, -1, 1, 1]
    for command, thrust, torque in ((together, wave.std(), 0.0), (rolling, 0.0, wave.std())):
        (one,) = summaries([calm(command=command.astype(np.float32))])
        assert one.command == pytest.approx(0.5, abs=1e-6)
        assert one.thrust_spread == pytest.approx(thrust, abs=1e-6)
        assert one.torque_spread == pytest.approx(torque, abs=1e-6)
        assert one.is_calm == (torque == 0.0)


def test_tilt_and_speed_are_those_of_the_flight():
    attitude = np.zeros((120, 3), np.float32)
    attitude[60] = [0.3, 0.4, 1.0]
    velocity = np.tile(np.array([0.3, 0.0, 0.4], np.float32), (120, 1))
    rates = np.tile(np.array([0.3, 0.4, 9.0], np.float32), (120, 1))
    (one,) = summaries([calm(attitude=attitude, velocity=velocity, body_rates=rates)])
    assert one.tilt == pytest.approx(np.arccos(np.cos(0.3) * np.cos(0.4)), abs=1e-6)
    assert (one.speed, one.body_rates) == pytest.approx((0.5, 0.5))


def rolling(name: str, size: float, axis: int = 0):
    """A flight at 5 Hz about roll or pitch."""
    wave = size * np.sin(2 * np.pi * 5 * np.arange(400) * 0.01)
    command = 0.5 + wave[:, None] * TORQUES[:, axis]
    return calm(400, name=name, command=command.astype(np.float32))


def test_information_grows_with_the_square_of_the_excitation_and_belongs_to_its_axis():
    weak, strong, pitching = summaries(
        [rolling("weak", 0.02), rolling("strong", 0.04), rolling("pitching", 0.04, axis=1)]
    )
    for name in ("lag", "inertia x"):
        ratio = strong.information[name] / weak.information[name]
        assert ratio == pytest.approx(4.0, rel=1e-3)
    assert pitching.information["inertia x"] < 1e-6 * strong.information["inertia x"]
    # A sine's derivative is its amplitude times its angular frequency.
    squared = weak.information["lag"] / weak.information["inertia x"]
    assert squared == pytest.approx((2 * np.pi * 5) ** 2, rel=0.05)


def test_logs_are_ranked_by_what_they_tell_and_the_fewest_are_chosen():
    logs = summaries(
        [rolling("weak", 0.004), rolling("roll", 0.05), rolling("pitch", 0.04, axis=1)]
    )
    ranked = rank(logs)
    assert {log.name for log, _ in ranked[:2]} == {"roll", "pitch"}
    assert sum(shares["inertia x"] for _, shares in ranked) == pytest.approx(1.0)
    assert {log.name for log in choose_most_telling(rank(logs), 0.5)} >= {"roll", "pitch"}
