"""A sample of flights: bounded, of every flight, with windows that the whole flights have; and
nothing changes where all fits."""

import weakref

import numpy as np
import pytest

from made_flights import calm, same
from maidenflight.flights import sampling
from maidenflight.flights.log import GROUPS
from maidenflight.flights.sampling import sampled
from maidenflight.flights.windows import windows
from maidenflight.identification.likelihood.selection import split


def flights(lengths=(3000, 150, 900, 2000)):
    return [calm(rows, seed, name=f"day/{seed}.csv") for seed, rows in enumerate(lengths)]


def test_what_fits_is_not_touched():
    given = flights()
    kept, duration = sampled(iter(given), 60.5)
    assert duration == pytest.approx(60.5)
    assert all(one is other for one, other in zip(kept, given, strict=True))


@pytest.mark.parametrize("most", [60.4, 30.0, 12.0, 6.0])
def test_every_flight_gives_alike_and_no_more_than_asked_for(most):
    given = flights()
    kept, duration = sampled(given, most)
    assert duration == pytest.approx(60.5)
    seconds = {
        flight.name: sum(part.duration for part in kept if part.name == flight.name)
        for flight in given
    }
    assert sum(seconds.values()) <= most + 0.01 * len(kept)
    assert min(seconds.values()) >= 1.0
    for flight in given:
        assert (
            seconds[flight.name] == pytest.approx(flight.duration)
            or seconds[flight.name] > max(seconds.values()) - 2.4
        )


@pytest.mark.parametrize(
    ("length", "every", "history"), [(100, 100, 100), (30, 10, 100), (30, 10, 7), (100, 100, 250)]
)
@pytest.mark.parametrize("zero_order_hold", [True, False])
def test_windows_of_a_sample_are_windows_of_the_whole_flights_to_the_bit(
    length, every, history, zero_order_hold
):
    given = [
        calm(rows, seed, zero_order_hold=zero_order_hold) for seed, rows in enumerate((3000, 2000))
    ]
    kept, _ = sampled(given, 25.0, history)
    few, all_of_them = windows(kept, length, every, history), windows(given, length, every, history)
    assert 20 * 100 / every <= len(few.segment) <= 25 * 100 / every
    place = {row.tobytes(): number for number, row in enumerate(all_of_them.position)}
    found = [place[row.tobytes()] for row in few.position]
    assert len(set(found)) == len(found)
    for one, other in zip(few[:-1], all_of_them[:-1], strict=True):
        np.testing.assert_array_equal(one, other[found])
    assert np.bincount(few.segment).max() * every <= 500


def test_a_smaller_sample_is_a_part_of_a_larger_one():
    given = flights((2500,) * 8)

    def starts(most):
        return {row.tobytes() for row in windows(sampled(given, most)[0], 100, 100).position}

    assert starts(20.0) < starts(60.0) < starts(150.0)


def test_what_a_flight_gives_depends_on_how_long_all_are_and_not_on_what_was_cut_on_the_way():
    given = flights((2500, 800, 3000, 100, 1700, 2500, 60, 4000))
    share = sampling._share(np.array([flight.duration for flight in given]), 20.0)
    at_once = [
        part
        for number, flight in enumerate(given)
        for part in sampling._shortened([flight], number, share, 100)
    ]
    assert all(
        same(one, other) for one, other in zip(sampled(given, 20.0)[0], at_once, strict=True)
    )


def test_what_is_not_kept_is_forgotten_while_others_are_read():
    alive = weakref.WeakValueDictionary()
    whole = []

    def read(count):
        for number in range(count):
            flight = calm(2000, number, name=str(number))
            alive[number] = flight
            yield flight
            del flight
            whole.append(len(alive))

    kept, duration = sampled(read(40), 30.0)
    assert duration == pytest.approx(800.0)
    assert max(whole) <= 3, "flights that are held whole"
    assert len({part.name for part in kept}) == 40
    for part in kept:
        assert all(getattr(part, group).base is None for group in GROUPS if group != "time"), (
            "a view would hold the whole flight"
        )


def test_segments_of_a_flight_are_fitted_or_judged_by_together():
    kept, _ = sampled(flights((3000,) * 6), 60.0)
    assert len(kept) >= 12
    fitted, judged = split(kept)
    assert len(fitted) + len(judged) == len(kept)
    assert {part.name for part in judged} == {"day/2.csv", "day/5.csv"}
    assert {part.name for part in fitted} == {f"day/{seed}.csv" for seed in (0, 1, 3, 4)}
    fitted, judged = split(sampled(flights((6000,)), 40.0)[0])
    assert (len(fitted), len(judged)) == (6, 3), "of one flight, every third stretch"


def test_flights_too_short_for_a_stretch_are_kept():
    given = flights((120,) * 20)
    kept, _ = sampled(given, 10.0)
    assert all(same(one, other) for one, other in zip(kept, given, strict=True))
