"""Checking: a fault costs its own rows and a note, a wrong unit costs the file, and a clean flight
costs nothing."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis.extra.numpy import arrays

from made_flights import calm, same
from maidenflight.errors import InputError
from maidenflight.flights.checks import checking


def spoilt(group, column, value, rows=slice(80, 86), flight=None):
    """A calm flight, one column of it overwritten in some rows."""
    flight = flight or calm(rows=200)
    values = getattr(flight, group).copy()
    values[rows, column] = value
    return replace(flight, **{group: values})


def part(flight, start, stop):
    groups = ("position", "velocity", "attitude", "body_rates", "command", "battery", "setpoint")
    return replace(flight, **{group: getattr(flight, group)[start:stop] for group in groups})


def test_a_clean_flight_passes_whole_and_without_notes():
    kept, notes = checking.pieces(calm(rows=200))
    assert notes == []
    assert [len(piece) for piece in kept] == [200]
    assert same(kept[0], calm(rows=200))
    assert (kept[0].name, kept[0].zero_order_hold, kept[0].period) == ("calm", True, 0.01)


FAULTS = [
    *[
        (group, 2, value, f"not a finite number in {name}")
        for group, name in (
            ("position", "position_z"),
            ("velocity", "velocity_z"),
            ("attitude", "yaw"),
            ("body_rates", "body_rate_z"),
        )
        for value in (np.nan, np.inf)
    ],
    ("command", 3, np.nan, "not a finite number in command_4"),
    ("command", 1, 3.1, "command outside [0, 3]"),
    ("command", 1, -0.2, "command outside [0, 3]"),
    ("attitude", 0, 1.06, "tilt above 60 deg"),
    ("attitude", 1, -1.06, "tilt above 60 deg"),
    ("body_rates", 2, -25.5, "body rate above 25 rad/s"),
    ("position", 2, 0.09, "below 0.1 m"),
]


@pytest.mark.parametrize(("group", "column", "value", "words"), FAULTS)
def test_a_fault_drops_exactly_its_rows_and_says_so(group, column, value, words):
    flight = spoilt(group, column, value)
    kept, notes = checking.pieces(flight)
    assert notes == [f"calm: 6 rows dropped: {words} (first: row 81)"]
    assert [len(piece) for piece in kept] == [80, 114]
    assert same(kept[0], part(flight, 0, 80))
    assert same(kept[1], part(flight, 86, 200))


ALL, SOME = slice(None), slice(80, 86)
BOLD = [
    ("attitude", 2, 3.1, SOME),
    ("body_rates", 0, 24.5, SOME),
    ("position", 2, 0.11, ALL),
    ("command", 1, 0.0, SOME),
    ("command", ALL, 0.0, SOME),
    ("command", 1, 1.6, SOME),
    ("battery", ..., np.nan, ALL),
    ("setpoint", ..., np.nan, ALL),
]


def test_a_tilt_just_below_the_limit_is_kept():
    flight = calm(rows=90)
    flight.attitude[:, 0] = 1.04
    kept, notes = checking.pieces(flight)
    assert ([len(piece) for piece in kept], notes) == ([90], [])


@pytest.mark.parametrize(("group", "column", "value", "rows"), BOLD)
def test_what_is_only_bold_or_unknown_is_kept(group, column, value, rows):
    unknown = np.full_like(getattr(calm(rows=200), group), value)
    flight = (
        replace(calm(rows=200), **{group: unknown})
        if column is ...
        else spoilt(group, column, value, rows)
    )
    kept, notes = checking.pieces(flight)
    assert ([len(piece) for piece in kept], notes) == ([200], [])


def test_a_row_with_two_faults_is_counted_once():
    _, notes = checking.pieces(spoilt("position", 2, 0.0, flight=spoilt("attitude", 0, 1.2)))
    assert notes == ["calm: 6 rows dropped: tilt above 60 deg (first: row 81)"]


def test_faults_at_both_ends_leave_the_middle():
    flight = spoilt(
        "position", 2, 0.02, slice(0, 30), spoilt("command", slice(None), 0.0, slice(140, 200))
    )
    kept, notes = checking.pieces(flight)
    assert [len(piece) for piece in kept] == [110]
    assert notes == [
        "calm: 30 rows dropped: below 0.1 m (first: row 1)",
        "calm: 60 rows dropped: motors off for 0.5 s or longer (first: row 141)",
    ]


@pytest.mark.parametrize(
    ("shortest", "lengths"), [(50, [80, 114]), (80, [80, 114]), (81, [114]), (115, [])]
)
def test_pieces_that_are_too_short_are_dropped_with_a_note(shortest, lengths):
    kept, notes = checking.pieces(spoilt("position", 2, 0.0), shortest=shortest)
    assert [len(piece) for piece in kept] == lengths
    what = {0: [], 1: ["80 rows dropped: a piece"], 2: ["194 rows dropped: 2 pieces"]}[
        2 - len(lengths)
    ]
    assert notes[1:] == [f"calm: {words} shorter than {shortest * 0.01:g} s" for words in what]


@pytest.mark.parametrize(
    ("group", "factor", "words"),
    [
        ("attitude", 180 / np.pi, ["roll, pitch", "expected rad,", "degrees"]),
        ("body_rates", 180 / np.pi, ["body_rate", "expected rad/s,", "degrees a second"]),
        ("command", 65535.0, ["command", "share of full thrust", "PWM counts"]),
        ("position", 1000.0, ["position", "expected m,", "millimetres"]),
        ("velocity", 1000.0, ["velocity", "expected m/s,", "millimetres"]),
        ("battery", 1000.0, ["battery", "expected V,", "millivolts"]),
        ("command", -1.0, ["command", "actions"]),
    ],
)
def test_a_wrong_unit_is_refused_with_the_right_one(group, factor, words):
    flight = calm(rows=200)
    wrong = replace(flight, **{group: getattr(flight, group) * np.float32(factor)})
    with pytest.raises(InputError, match="calm: " + ".*".join(words)):
        checking.pieces(wrong)


def test_a_flight_without_one_finite_number_has_no_pieces():
    empty = np.full((200, 3), np.nan, np.float32)
    kept, notes = checking.pieces(calm(rows=200, position=empty, attitude=empty))
    assert kept == []
    assert notes == [
        "calm: 200 rows dropped: not a finite number in position_x, position_y, position_z ... "
        "(first: row 1)"
    ]


def clock(rows=200):
    return np.arange(rows) * 0.01


def test_a_steady_clock_cuts_nothing():
    kept, notes = checking.pieces(calm(rows=200), clock() + 3.0)
    assert [len(piece) for piece in kept] == [200]
    assert notes == []


@pytest.mark.parametrize("jump", [0.02, 5.0, -0.4])
def test_missing_rows_and_time_running_backwards_cut_the_flight(jump):
    time = clock()
    time[70:] += jump
    kept, notes = checking.pieces(calm(rows=200), time)
    assert [len(piece) for piece in kept] == [70, 130]
    assert same(kept[1], part(calm(rows=200), 70, 200))
    assert notes == [
        f"calm: cut at a jump of time (largest {0.01 + jump:.3f} s at t = 0.69 s, row 71)"
    ]


def test_jitter_of_less_than_half_a_period_cuts_nothing():
    jitter = np.random.default_rng(0).uniform(-0.0024, 0.0024, 200)
    assert len(checking.pieces(calm(rows=200), clock() + jitter)[0]) == 1


@pytest.mark.parametrize(
    "time", [np.cumsum(np.tile([0.001, 0.02, 0.1, 0.4], 50)), np.zeros(200), clock()[::-1]]
)
def test_rows_at_no_steady_rate_are_refused(time):
    with pytest.raises(InputError, match="not equally spaced"):
        checking.pieces(calm(rows=200, period=float(np.median(np.diff(time)))), time)


def test_milliseconds_are_refused():
    with pytest.raises(InputError, match=r"rows are 10 s apart; expected seconds.*milliseconds"):
        checking.pieces(calm(rows=200, period=10.0), 1000 * clock())


def test_a_row_without_a_time_is_refused_by_its_number():
    time = clock()
    time[41] = np.nan
    with pytest.raises(InputError, match="row 42"):
        checking.pieces(calm(rows=200), time)


def test_a_log_that_stands_still_loses_those_rows():
    flight = calm(rows=300)
    held = np.minimum(np.arange(300), 100) + np.maximum(np.arange(300) - 150, 0)
    stuck = replace(
        flight,
        **{
            group: getattr(flight, group)[held]
            for group in ("position", "velocity", "attitude", "body_rates", "command")
        },
    )
    kept, notes = checking.pieces(stuck)
    assert notes == ["calm: 50 rows dropped: every column stands still (first: row 102)"]
    assert [len(piece) for piece in kept] == [101, 149]


@pytest.mark.parametrize(
    ("group", "words"), [("position", "position jumps"), ("attitude", "attitude jumps")]
)
def test_a_jump_of_the_estimate_costs_one_row_and_cuts_there(group, words):
    flight = calm(rows=300)
    jumped = getattr(flight, group).copy()
    jumped[150:, 0] += 0.6
    kept, notes = checking.pieces(replace(flight, **{group: jumped}))
    assert len(notes) == 1
    assert f"1 rows dropped: {words}" in notes[0]
    assert "row 151" in notes[0]
    assert [len(piece) for piece in kept] == [150, 149]


def test_a_weak_battery_is_told_and_kept():
    kept, notes = checking.pieces(calm(rows=200, battery=np.full(200, 2.6, np.float32)))
    assert len(kept[0]) == 200
    assert notes == [
        "calm: 200 rows kept with the battery below 2.8 V, where the firmware can no longer make "
        "up for it"
    ]
    plain = calm(rows=200, battery=np.full(200, 2.6, np.float32), by_battery_law=False)
    assert checking.pieces(plain)[1] == []


@given(cuts=arrays(bool, 40), rows=arrays(bool, 40))
def test_runs_hold_every_true_row_once_and_no_cut_inside(cuts, rows):
    runs = checking._runs(rows, cuts)
    covered = np.zeros(40, int)
    for start, stop in runs:
        covered[start:stop] += 1
        assert not cuts[start + 1 : stop].any()
    np.testing.assert_array_equal(covered, rows.astype(int))


def test_jittered_and_lossy_rows_are_resampled_to_the_signals_at_even_times():
    true = calm(1200, 2)
    generator = np.random.default_rng(0)
    time = np.arange(1200) * 0.01 + generator.normal(0, 0.002, 1200)
    kept = np.flatnonzero(generator.random(1200) > 0.1)
    time = time[kept]
    rows = {
        group: np.stack(
            [np.interp(time, np.arange(1200) * 0.01, row) for row in getattr(true, group).T], axis=1
        )
        for group in ("position", "velocity", "attitude", "body_rates")
    }
    lossy = replace(
        true.part(0, len(kept)), zero_order_hold=False, command=true.command[kept], **rows
    )
    pieces, notes = checking.pieces(lossy, time)
    (even,) = pieces
    assert notes
    assert abs(len(even) - 1200) <= 5
    start = np.argmin(np.abs(np.arange(1200) * 0.01 - time[0])) * 0.01
    shift = round(start / 0.01)
    expected = true.part(shift, shift + len(even) - 5)
    # Two rows are 20 ms apart where one is missing: half of acceleration times 10 ms squared.
    np.testing.assert_allclose(even.part(0, len(expected)).position, expected.position, atol=2e-3)


def test_a_long_gap_stays_a_gap_when_rows_are_resampled():
    true = calm(900, 2)
    rows = np.r_[0:300, 400:900]
    rows = rows[np.random.default_rng(0).random(len(rows)) > 0.1]
    lossy = replace(
        true.part(0, len(rows)),
        **{
            group: getattr(true, group)[rows]
            for group in ("position", "velocity", "attitude", "body_rates", "command")
        },
    )
    pieces, _ = checking.pieces(lossy, rows * 0.01)
    assert [round(piece.duration) for piece in pieces] == [3, 5]


def test_a_flight_whose_end_runs_away_keeps_what_was_before():
    wild = np.linspace(26.0, 900.0, 80)
    flight = spoilt("body_rates", 1, wild, slice(220, 300), calm(rows=300))
    kept, notes = checking.pieces(flight)
    assert [len(piece) for piece in kept] == [220]
    assert any("row 221" in note for note in notes)


def test_a_gyro_in_degrees_is_no_run_away():
    flight = calm(rows=300)
    swing = np.sin(np.arange(300) / 7.0)[:, None] * np.array([300.0, 200.0, 100.0])
    with pytest.raises(InputError, match="degrees"):
        checking.pieces(replace(flight, body_rates=swing.astype(np.float32)))


def test_heights_below_the_ground_are_taken_for_z_down():
    flight = calm(rows=200)
    with pytest.raises(InputError, match="NED"):
        checking.pieces(
            replace(flight, position=flight.position * np.array([1, -1, -1], np.float32))
        )
