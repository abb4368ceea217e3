"""Windows: every row is where it belongs, and no window looks from one flight into another.

The flights here carry their own number and row in every column, so that a row out of place shows.
"""

import numpy as np
import pytest

from made_flights import calm
from maidenflight.errors import InputError
from maidenflight.flights.windows import EVERY, LEAD_IN, SEGMENT_SECONDS, SHORTEST_LEAD_IN, windows

LENGTH = 30


def numbered(number, rows, **changes):
    """A flight whose every column is 10,000 times its number, plus the row, plus a share for the
    column."""
    row = 10_000.0 * number + np.arange(rows)[:, None]
    columns = {
        group: np.float32(row + offset)
        for group, offset in (("position", 0.0), ("velocity", 0.25), ("body_rates", 0.5))
    }
    columns = {group: np.tile(values, (1, 3)) for group, values in columns.items()}
    attitude = np.float32(
        np.stack([0.1 + 0 * row[:, 0], 1e-4 * np.arange(rows), 0 * row[:, 0]], axis=1)
    )
    return calm(
        rows, **columns, attitude=attitude, command=np.float32(np.tile(row, (1, 4))), **changes
    )


@pytest.fixture(scope="module")
def cut():
    """Windows of three flights, one of which is too short to give any."""
    return windows(
        [numbered(1, 200), numbered(2, SHORTEST_LEAD_IN + LENGTH), numbered(3, 3001)], LENGTH
    )


def begins(rows):
    """First rows of all windows that a flight of so many rows holds."""
    return np.arange(SHORTEST_LEAD_IN, rows - LENGTH, EVERY)


def test_every_tenth_row_that_has_a_past_and_a_future_starts_a_window(cut):
    np.testing.assert_array_equal(
        cut.position[:, 0], [*(10_000 + begins(200)), *(30_000 + begins(3001))]
    )
    assert begins(3001)[-1] + LENGTH == 3000, "the last window ends in the last row"
    assert EVERY == 10


def test_the_state_at_the_start_is_the_starting_rows(cut):
    row = cut.position[:, :1]
    np.testing.assert_array_equal(cut.position, np.tile(row, (1, 3)))
    np.testing.assert_array_equal(cut.velocity, np.tile(row + np.float32(0.25), (1, 3)))
    np.testing.assert_array_equal(cut.body_rates, np.tile(row + np.float32(0.5), (1, 3)))
    half = np.array([0.05, 0.5e-4 * SHORTEST_LEAD_IN])
    roll_only = [
        np.sin(half[0]) * np.cos(half[1]),
        np.cos(half[0]) * np.sin(half[1]),
        -np.sin(half[0]) * np.sin(half[1]),
        np.prod(np.cos(half)),
    ]
    np.testing.assert_allclose(cut.quaternion[0], roll_only, atol=1e-6)


def test_what_is_to_be_predicted_are_the_rows_after_the_start(cut):
    expected = cut.position[:, :1] + np.arange(1, LENGTH + 1, dtype=np.float32)
    for columns, offset in ((slice(0, 3), 0.0), (slice(3, 6), 0.25), (slice(9, 12), 0.5)):
        np.testing.assert_array_equal(
            cut.measured[:, :, columns],
            np.tile(expected[:, :, None] + np.float32(offset), (1, 1, 3)),
        )
    np.testing.assert_allclose(
        cut.measured[0, :, 7], 1e-4 * (SHORTEST_LEAD_IN + np.arange(1, LENGTH + 1)), rtol=1e-5
    )


def test_commands_run_from_the_history_to_the_last_period(cut):
    first = 10_000 * np.floor(cut.position[:, :1] / 10_000)
    expected = np.maximum(
        cut.position[:, :1] + np.arange(-LEAD_IN, LENGTH, dtype=np.float32), first
    )
    assert (expected[:, 0] == first[:, 0]).any(), "the first row stands for what came before it"
    np.testing.assert_array_equal(cut.command, np.tile(expected[:, :, None], (1, 1, 4)))


def test_sampled_commands_are_averaged_over_their_period():
    cut = windows([numbered(1, 200, zero_order_hold=False)], LENGTH)
    rows = np.maximum(np.arange(-LEAD_IN, LENGTH) + SHORTEST_LEAD_IN, 0)
    np.testing.assert_allclose(cut.command[0, :, 0], 10_000.5 + rows)


def test_no_window_crosses_two_flights(cut):
    flight = np.floor(cut.position[:, 0] / 10_000)
    assert (np.floor(cut.measured[:, -1, 0] / 10_000) == flight).all()
    assert (np.floor(cut.command[:, 0, 0] / 10_000) == flight).all()


def test_segments_are_contiguous_segments_of_one_flight(cut):
    assert (np.diff(cut.segment) >= 0).all()
    np.testing.assert_array_equal(np.unique(cut.segment), np.arange(cut.segment.max() + 1))
    for block in range(cut.segment.max() + 1):
        rows = cut.position[cut.segment == block, 0]
        assert (np.diff(rows) == EVERY).all(), "one stretch"
        assert len(rows) * EVERY * 0.01 <= 1.25 * SEGMENT_SECONDS
    assert cut.segment.max() + 1 == 1 + round(30.01 / SEGMENT_SECONDS)


def test_windows_are_float32_and_of_the_sizes_promised(cut):
    count = len(cut.segment)
    assert cut.measured.shape == (count, LENGTH, 12)
    assert cut.command.shape == (count, LEAD_IN + LENGTH, 4)
    assert cut.quaternion.shape == (count, 4)
    assert {array.dtype for name, array in cut._asdict().items() if name != "segment"} == {
        np.dtype(np.float32)
    }


def test_the_distance_between_starts_can_be_chosen():
    cut = windows([numbered(1, 200)], LENGTH, every=7)
    assert (np.diff(cut.position[:, 0]) == 7).all()


def test_the_length_of_the_history_can_be_chosen():
    assert windows([numbered(1, 200)], LENGTH, lead_in=30).command.shape[1:] == (30 + LENGTH, 4)


def test_without_a_lead_in_motors_and_delay_line_begin_at_rest():
    usual, rest = (windows([numbered(1, 200)], LENGTH, lead_in=rows).command for rows in (1, 0))
    assert not rest[:, 0].any()
    np.testing.assert_array_equal(rest[:, 1:], usual[:, 1:])


def test_flights_of_different_rates_are_refused():
    with pytest.raises(InputError, match=r"different rates: \S* has 50 Hz, \S* 100 Hz"):
        windows([calm(200), calm(200, period=0.02)], LENGTH)


def test_flights_that_are_too_short_are_refused_with_what_is_needed():
    least = SHORTEST_LEAD_IN + LENGTH + 1
    assert len(windows([calm(least)], LENGTH).segment) == 1
    with pytest.raises(
        InputError, match=rf"longest {0.01 * (least - 1):.2f} s, needed {0.01 * least:.2f} s"
    ):
        windows([calm(least - 1), calm(10)], LENGTH)


def test_no_flight_at_all_is_refused():
    with pytest.raises(InputError, match="no flight is long enough"):
        windows([], LENGTH)


def test_with_a_stride_rows_are_farther_apart_and_all_commands_are_kept():
    """A log of 500 Hz gives windows of 100 Hz with five commands to a row."""
    stride, history = 5, 40
    fast = numbered(1, 3000, period=0.002)
    cut = windows([fast], LENGTH, every=LENGTH, lead_in=history, stride=stride)
    start = cut.position[:, 0]
    assert start[0] == 10_000 + stride * SHORTEST_LEAD_IN
    np.testing.assert_array_equal(np.diff(start), stride * LENGTH)
    np.testing.assert_array_equal(
        cut.measured[:, :, 0], start[:, None] + stride * np.arange(1, LENGTH + 1)
    )
    expected = start[:, None] + np.arange(-history * stride, LENGTH * stride)
    np.testing.assert_array_equal(cut.command[:, :, 0], np.maximum(expected, 10_000))
