"""Flight plans: what is written is read back, what is damaged is refused, set-points fit."""

import re

import numpy as np
import pytest

from maidenflight.errors import InputError
from maidenflight.flights import flight_plan
from maidenflight.flights.flight_plan import REST, Block, ExpectedWidths, Extremes, FlightPlan
from maidenflight.flights.manoeuvres import KINDS, MOTORS, RATE, Manoeuvre, library

WHOLE = FlightPlan(
    (
        Block(Manoeuvre("hover"), 2.0),
        Block(Manoeuvre("steps_z", 0.2, 0.6), 4.0),
        Block(Manoeuvre("random_yaw", 0.1, 0.8), 2.0),
        Block(Manoeuvre(MOTORS, 0.06), 2.0),
    ),
    (2.0, 2.0, 1.5),
    0.8,
    3,
    {"latency": ExpectedWidths(0.001, 0.002, 0.015)},
    Extremes(0.3, 0.2, 0.6, 1.1, 0.4, 0.9, 0.3, 0.25, 0.01),
    {"version": "0.1.0", "seed": 7, "inputs": ["drone.toml sha256:ab12"], "settings": {}},
)
TEXT = WHOLE.to_toml()


def test_a_plan_reads_back_as_it_was_written(tmp_path):
    path = WHOLE.write(tmp_path / "plan.toml")
    found = flight_plan.read(path)
    assert found.name == str(path)
    assert found.to_toml() == TEXT
    assert found.blocks == WHOLE.blocks
    assert found.expected == WHOLE.expected
    assert found.extremes == WHOLE.extremes
    assert found.record == WHOLE.record
    np.testing.assert_array_equal(found.setpoints(), WHOLE.setpoints())


def test_setpoints_last_as_long_as_said_rest_at_the_point_and_depend_on_the_seed_alone():
    places, strength = WHOLE.setpoints(), WHOLE.excitation()
    assert WHOLE.seconds == 14.0
    assert places.shape == (1400, 4)
    assert strength.shape == (1400,)
    end = 0
    for block in WHOLE.blocks:
        end += round((block.seconds + REST) * RATE)
        rest = places[end - round(REST * RATE) : end]
        np.testing.assert_array_equal(rest, np.tile([0.0, 0.0, 0.8, 0.0], (len(rest), 1)))
    assert set(np.unique(strength)) == {0.0, 0.06}
    assert not WHOLE.by_setpoints
    calm = flight_plan.hovering(WHOLE)
    assert calm.by_setpoints
    assert calm.setpoints().shape == places.shape
    assert np.ptp(calm.setpoints(), axis=0).max() == 0.0


@pytest.mark.parametrize("kind", KINDS)
def test_manoeuvres_stay_within_their_size_and_the_same_seed_is_the_same(kind):
    one = Manoeuvre(kind, 0.2, 0.8)
    places = one.setpoints(6.0, 1)
    assert places.shape == (600, 4)
    np.testing.assert_array_equal(places, one.setpoints(6.0, 1))
    assert np.abs(places[:, :3]).max() <= 0.2
    moved = np.ptp(places, axis=0) > 0
    wanted = {
        "hover": "",
        "motors": "",
        "circle": "xy",
        "random": "xyz",
        "random_yaw": "xyzw",
        "steps_yaw": "w",
    }.get(kind, kind[-1])
    assert "".join(np.array(list("xyzw"))[moved]) == wanted


def test_a_chirp_grows_faster_and_steps_alternate():
    chirp = Manoeuvre("chirp_x", 0.2, 2.0).setpoints(8.0, 0)[:, 0]
    crossings = np.flatnonzero(np.diff(np.sign(chirp[1:])))
    assert np.sum(crossings > 400) > 1.5 * np.sum(crossings <= 400)
    steps = Manoeuvre("steps_y", 0.1, 0.6).setpoints(6.0, 0)[:, 1]
    assert np.mean(steps) == pytest.approx(0.0, abs=1e-9)
    assert np.count_nonzero(np.diff(steps)) == 19


def test_the_library_keeps_to_the_room_and_to_setpoints_unless_motors_are_allowed():
    small = library(0.15, 0.1, motors=False)
    assert all(one.by_setpoints for one in small)
    for one in small:
        places = one.setpoints(5.0, 0)
        assert np.abs(places[:, :2]).max() <= 0.15 + 1e-9
        assert np.abs(places[:, 2]).max() <= 0.1 + 1e-9
    wide = library(1.0, 0.5, motors=True)
    assert len(set(wide)) == len(wide) > len(small)
    assert len({one.name for one in wide}) == len(wide)
    assert not all(one.by_setpoints for one in wide)


def swapped(pattern: str, by: str) -> str:
    found, count = re.subn(pattern, by, TEXT, count=1, flags=re.MULTILINE)
    assert count == 1, pattern
    return found


DAMAGED = {
    "empty": "",
    "no text": "\x00\x01",
    "truncated": TEXT[: TEXT.index("[[manoeuvres]]") + 20],
    "another format": swapped(r"^format = 1", "format = 2"),
    "a room of two": swapped(r"^room = .*", "room = [2.0, 2.0]"),
    "a room of nothing": swapped(r"^room = .*", "room = [0.0, 0.0, 0.0]"),
    "a small room": swapped(r"^room = .*", "room = [2.0, 2.0, 0.9]"),
    "a narrow room": swapped(r"^size = 0\.1$", "size = 1.2"),
    "a height above the room": swapped(r"^height = 0\.8", "height = 1.6"),
    "a height that is a text": swapped(r"^height = 0\.8", 'height = "0.8"'),
    "a seed below zero": swapped(r"^seed = 3", "seed = -1"),
    "a seed of a half": swapped(r"^seed = 3", "seed = 0.5"),
    "another kind": swapped(r'^kind = "steps_z"', 'kind = "looping"'),
    "a kind that is a number": swapped(r'^kind = "steps_z"', "kind = 3"),
    "a size that is nan": swapped(r"^size = 0\.2", "size = nan"),
    "a size below zero": swapped(r"^size = 0\.2", "size = -0.2"),
    "a huge size": swapped(r"^size = 0\.2", "size = 20.0"),
    "no period": swapped(r"^period = 0\.6\n", ""),
    "a period of zero": swapped(r"^period = 0\.6", "period = 0.0"),
    "no seconds": swapped(r"^seconds = 4\.0", "seconds = 0.0"),
    "an hour": swapped(r"^seconds = 4\.0", "seconds = 600.0"),
    "a misspelt entry": swapped(r"^seconds = 4\.0", "seconds = 4.0\nspeed = 2.0"),
    "a misspelt entry at the top": swapped(r"^seed = 3", "seed = 3\nsede = 3"),
    "of no parameter": swapped(r"^\[expected\.latency\]", "[expected.patience]"),
    "an expectation that is a text": swapped(r"^hover = 0\.002", 'hover = "a"'),
    "extremes that lack one": swapped(r"^tilt = .*\n", ""),
    "a record that is a value": re.sub(r"\[record\][\s\S]*", "", TEXT).replace(
        "format = 1", "format = 1\nrecord = 3"
    ),
}


@pytest.mark.parametrize("what", DAMAGED)
def test_a_damaged_plan_is_refused_by_its_name(what, tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text(DAMAGED[what])
    with pytest.raises(InputError, match=re.escape(str(path))) as refused:
        flight_plan.read(path)
    assert "maidenflight plan" in str(refused.value) or "record" in str(refused.value)


def test_what_is_no_file_is_refused(tmp_path):
    for path in (tmp_path / "none.toml", tmp_path):
        with pytest.raises(InputError):
            flight_plan.read(path)


def test_a_pilot_flies_by_hand_what_follows_setpoints() -> None:
    by_hand = {kind: Manoeuvre(kind).by_hand for kind in KINDS}
    assert [kind for kind, sticks in by_hand.items() if not sticks] == [MOTORS]
    assert by_hand["steps_z"] == by_hand["chirp_z"] != by_hand["steps_x"]
    assert by_hand["steps_yaw"] != by_hand["random_yaw"]
