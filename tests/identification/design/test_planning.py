"""Planning: what is proposed fits the room on other drones too and tells more than a hover."""

import dataclasses
from pathlib import Path

import jax
import numpy as np
import pytest

from maidenflight.errors import InputError
from maidenflight.flights.flight_plan import REST, Extremes
from maidenflight.flights.manoeuvres import HOVER
from maidenflight.flying.recording import fly_plans
from maidenflight.identification.design import optimal_design, planning
from maidenflight.identification.design.flight_limits import (
    LOWEST,
    MARGIN,
    FlightLimits,
    extremes_of,
)
from maidenflight.identification.design.planning import CHUNK, Request
from maidenflight.identification.drone_file import Advice, DroneFile, Estimate, Search, Source
from maidenflight.identification.posterior import Posterior
from maidenflight.parameters import crazyflie
from maidenflight.simulator.realities.virtual_drone import virtual_drone
from maidenflight.verbs.plan import _find_gaps
from maidenflight.verbs.record import Record
from run_listing import entries, unlisted

ROOM = (2.0, 2.0, 1.5)
SAFE = Extremes(0.3, 0.3, 0.6, 1.1, 0.3, 1.0, 0.3, 0.2, 0.0)
DRONE = virtual_drone(3)


@pytest.mark.parametrize(
    ("what", "value"),
    [
        ("lateral_x", 0.85),
        ("lateral_y", 0.85),
        ("highest", 1.35),
        ("lowest", 0.25),
        ("tilt", 0.7),
        ("speed", 2.0),
        ("astray", 0.5),
        ("sunk", 0.31),
        ("at_limits", 0.1),
    ],
)
def test_each_limit_is_kept(what, value):
    assert FlightLimits().excess(SAFE, ROOM) == ""
    assert FlightLimits().excess(dataclasses.replace(SAFE, **{what: value}), ROOM) != ""


@pytest.mark.parametrize(
    ("room", "seconds", "interest", "rate"),
    [
        ((0.5, 2.0, 1.5), 60.0, None, 500),
        ((2.0, 2.0, 0.5), 60.0, None, 500),
        ((2.0, np.nan, 1.5), 60.0, None, 500),
        ((2.0, 2.0, 1e9), 60.0, None, 500),
        (ROOM, 1.0, None, 500),
        (ROOM, 1e6, None, 500),
        (ROOM, 60.0, ["patience"], 500),
        (ROOM, 60.0, None, 120),
    ],
)
def test_what_cannot_be_planned_is_refused(room, seconds, interest, rate):
    with pytest.raises(InputError):
        planning.plan(DRONE, Request(room, seconds, interest, rate), jax.random.key(0))


def test_drones_about_another_fly_by_its_law_and_differ():
    found = planning.about(DRONE)
    assert len(found) == planning.OTHERS
    assert all(one.thrust_law == DRONE.thrust_law for one in found)
    assert len({float(one.parameters.motor_time_constant) for one in found}) == len(found)


def test_what_the_logs_so_far_lack_is_unknown_in_a_plan_too(tmp_path):
    """Of a drone whose calm flights leave the curve of thrust open, with what a pilot flies."""
    advice = Advice("thrust_linear", "climb and sink", None)
    estimate = Estimate(1.9, (1.2, 2.6), (1.9,), 0.1)
    source, search = Source(1, 60.0, False, "subsampled", 60000.0), Search("likelihood", -1.0, 6, 1)
    known = {"thrust_to_weight": estimate}, Posterior({}), source, search
    unidentified = {"latency": (0.0, 0.012)}
    file = DroneFile(crazyflie(), *known, unidentified=unidentified, advice=(advice,))
    file.write(tmp_path / "mine.toml")
    gaps = _find_gaps(str(tmp_path / "mine.toml"))
    assert gaps == {"latency": "", "thrust_linear": "climb and sink"}
    assert _find_gaps("crazyflie") == {}
    names = planning._names(Request(ROOM, 60.0, gaps=tuple(gaps)), None)
    usual = planning._names(Request(ROOM, 60.0), None)
    assert set(names) - set(usual) == {"thrust_linear"}


@pytest.fixture(scope="module")
def proposed():
    """A plan that is safe on three other drones, and the stages of making it."""
    stages: list[tuple[int, int]] = []
    with pytest.MonkeyPatch.context() as fewer:
        fewer.setattr(planning, "OTHERS", 3)
        found = planning.plan(
            DRONE,
            Request(ROOM, 30.0, ["latency", "inertia_x", "inertia_y", "drag_x"], seed=4),
            jax.random.key(0),
            lambda done, of, what: stages.append((done, of)),
        )
    return found, stages


@pytest.mark.slow
def test_a_plan_is_whole_chunks_within_the_time_and_tells_more_than_a_hover(proposed):
    found, stages = proposed
    made = found.plan
    assert stages == sorted(stages)
    assert 30.0 - 3 * (CHUNK + REST) < made.seconds <= 30.0
    assert all(block.seconds % CHUNK == 0 for block in made.blocks)
    assert made.by_setpoints
    assert set(made.expected) == {"latency", "inertia_x", "inertia_y", "drag_x"}
    for one in made.expected.values():
        assert 0.0 < min(one.plan, one.hover) <= max(one.plan, one.hover)
        assert max(one.plan, one.hover) <= one.plausible * (1 + 1e-6)
    # All together, which is what a plan maximises; a single parameter may be told a little worse.
    shares = [one.plan / one.hover for one in made.expected.values()]
    assert np.prod(shares) < 0.3
    assert max(shares) < 1.3
    assert found.excess <= 2 * optimal_design.CLOSE
    assert HOVER not in found.left_out


@pytest.mark.slow
def test_the_room_is_kept_on_drones_that_it_was_not_planned_for(proposed):
    made = proposed[0].plan
    assert made.extremes is not None
    assert FlightLimits().excess(made.extremes, ROOM) == ""
    for seed in (1, 2, 4):
        (flown,) = fly_plans(
            virtual_drone(seed), [made], jax.random.split(jax.random.key(seed), 1), "2021.10"
        )
        found = extremes_of(flown.rows)
        assert max(found.lateral_x, found.lateral_y) < ROOM[0] / 2 - MARGIN / 2
        assert found.lowest > LOWEST - MARGIN / 2
        assert found.highest < ROOM[2] - MARGIN / 2
        assert found.astray < 0.6


@pytest.mark.slow
def test_a_plan_that_is_written_is_recorded_from_its_file(proposed, tmp_path):
    """On the drone that it was made for, unless another is named."""
    plan = dataclasses.replace(proposed[0].plan, record={"settings": {"drone": "virtual:3"}})
    path = plan.write(tmp_path / "plan.toml")
    recorded = Record(plan=path, seed=1, rate=100).run(tmp_path / "flights")
    assert recorded.record["settings"]["reality"] == "virtual:3"
    logs = [Path(log) for log in recorded.written["logs"]]
    assert [log.name for log in logs] == ["flight_01.csv"]
    assert "plan.toml sha256:" in logs[0].read_text()
    assert (tmp_path / "flights" / "reality.toml").exists()
    assert entries(tmp_path) == {("record", "flights"): {"logs", "truth"}}
    assert unlisted(tmp_path) == {"plan.toml"}
