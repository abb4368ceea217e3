"""Guards and reasons are the same of JAX and of NumPy."""

import jax
import jax.numpy as jnp
import numpy as np

from maidenflight.simulator.tasks.failures import (
    END_REASONS,
    TIME_LIMIT,
    ZERO_SHOT,
    End,
    Guard,
    excursion,
    first_end,
    largest,
    reason,
)


def test_a_guard_says_the_same_of_many_rows_in_numpy_and_of_each_in_jax():
    generator = np.random.default_rng(0)
    scales = (0.15, 0.3, 8.0)
    place, attitude, rates = (
        generator.normal(0, scale, (200, 3)).astype(np.float32) for scale in scales
    )
    place[5], rates[7, 0] = np.nan, np.inf
    rows = place, attitude, rates, np.zeros((200, 3), np.float32)
    found = reason(**ZERO_SHOT.trips(excursion(*rows)))
    assert isinstance(found, np.ndarray)
    one = jax.vmap(lambda *row: reason(**ZERO_SHOT.trips(excursion(*row))))
    np.testing.assert_array_equal(one(*map(jnp.asarray, rows)), found)
    assert [END_REASONS[found[row]] for row in (5, 7)] == ["not finite"] * 2
    assert {END_REASONS[index] for index in found} >= {"", "body rate", "tilt", "position error"}


def test_limits_that_are_not_given_end_nothing_but_what_is_not_finite():
    far = np.full((1, 3), 1e6)
    assert not any(Guard().trips(excursion(far, far, far, -far)).values())
    lost = Guard().trips(excursion(far, far * np.nan, far, far))
    assert reason(**lost) == END_REASONS.index("not finite")


def test_the_largest_of_a_flight_are_of_roll_and_pitch_and_of_the_whole_distance():
    rows = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    rows[0][1], rows[1][2], rows[2][0] = (3.0, 0.0, 4.0), (0.1, -0.2, 9.0), (-7.0, 2.0, 9.0)
    assert largest(excursion(*rows, np.zeros((3, 3)))) == {
        **{"largest_tilt": 0.2, "largest_body_rate": 7.0, "largest_distance": 5.0}
    }


def test_a_flight_ends_at_its_first_reason_or_at_the_time_limit():
    assert first_end(np.array([0, 0, 4, 3])) == End(3, 4)
    assert first_end(np.zeros(7, int)) == End(7, TIME_LIMIT)
