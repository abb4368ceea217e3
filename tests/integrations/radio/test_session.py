"""Recording from the fake drone: what is on disk, what `identify` makes of it, and when nothing
takes off."""

import contextlib
import dataclasses
import signal
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cflib")

from fake_drone import FakeDrone, Stepped
from simple_physics import MOTOR_TIME_CONSTANT, THRUST_TO_WEIGHT

import maidenflight as mf
from maidenflight import parameters, results
from maidenflight.errors import InputError
from maidenflight.flights.compensation import thrust_command
from maidenflight.flights.flight_plan import Block, FlightPlan
from maidenflight.flights.manoeuvres import Manoeuvre
from maidenflight.flights.reading import read_flights
from maidenflight.integrations.radio import flight, row_files, session
from maidenflight.integrations.radio.blocks import (
    LIMITS,
    MOTORS,
    PERIOD,
    STATE,
    VARIANCE,
    with_policy,
)
from maidenflight.integrations.radio.crazyflie import Crazyflie
from maidenflight.integrations.radio.flight import COMPLETE, PROMISED, Plan
from maidenflight.integrations.radio.preflight import Expected
from maidenflight.integrations.radio.watch import GUARDS, Limits
from maidenflight.simulator.tasks import trajectories
from run_listing import entries, unlisted

CIRCLE = trajectories.circle(0.5, 3.0, 1.0)


def plan(seconds=1.0, height=0.5, steps=0.0, seed=0, policy=False):
    places = session.reference(CIRCLE, seconds, height, steps, seed)
    return Plan(places, policy, on_board=LIMITS if policy else {})


def flown(fake, folder, *plans, stops=lambda: 0, said=None, before=None, care=session.Care()):  # noqa: B008
    clock, said = Stepped(fake), [] if said is None else said
    with fake, contextlib.closing(clock.connect()) as link:
        if before:
            clock.before.append(before)
        return session.flights(
            link,
            list(plans),
            folder,
            results.record(seed=3, inputs=[], settings={"task": "circle"}),
            clock=clock,
            stops=stops,
            say=said.append,
            care=care,
        )


def test_blocks_fit_into_the_26_bytes_of_a_packet():
    assert max(block.size for block in (STATE, with_policy(MOTORS), VARIANCE)) <= 26


def test_what_record_wrote_is_read_as_a_flight(tmp_path):
    (flight,) = flown(FakeDrone(), tmp_path, plan(4.0, 0.7, 0.1, 1))
    assert flight.ending.reason == COMPLETE
    read = read_flights(tmp_path)
    assert read.refused == ()
    assert len(read) == 1
    assert [(flight.simulated, flight.zero_order_hold) for flight in read] == [("udp", False)]


@pytest.mark.night
def test_identify_finds_the_fake_drone_in_what_record_wrote(tmp_path):
    flown(FakeDrone(), tmp_path, plan(4.0, 0.7, 0.1, 1))
    read = read_flights(tmp_path)
    start = parameters.replace(parameters.crazyflie(), latency=0.0)
    found = mf.identify(
        read,
        mf.Replay(trials=1, evaluations=11),
        over=["thrust_to_weight", "motor_time_constant"],
        start=start,
    )
    assert found.parameters.thrust_to_weight == pytest.approx(THRUST_TO_WEIGHT, rel=0.02)
    assert found.parameters.motor_time_constant == pytest.approx(MOTOR_TIME_CONSTANT, rel=0.2)


BY_SETPOINTS = FlightPlan(
    (Block(Manoeuvre("steps_yaw", 0.5, 1.0), 1.0), Block(Manoeuvre("steps_x", 0.1, 1.0), 1.0)),
    (2.0, 1.6, 1.5),
    0.5,
    name="mine.toml",
)


def test_a_flight_plan_becomes_positions_and_yaw_within_its_room():
    made = session.of_flight_plan(BY_SETPOINTS)
    places = BY_SETPOINTS.setpoints()
    np.testing.assert_array_equal(made.reference, places[:, :3])
    np.testing.assert_array_equal(made.yaw, places[:, 3])
    assert BY_SETPOINTS.seconds / len(places) == pytest.approx(PERIOD)
    narrow = session.within(BY_SETPOINTS.room, Limits())
    assert (narrow.fence, narrow.ceiling) == (0.8, 1.5)
    assert session.checked_plan(made, narrow) is made
    assert session.within((9.0, 9.0, 9.0), Limits()) == Limits()
    with pytest.raises(InputError):
        session.checked_plan(made, session.within((0.5, 0.5, 1.0), Limits()))


def test_excitation_of_motors_is_refused_before_anything_connects(tmp_path):
    shaken = dataclasses.replace(
        BY_SETPOINTS, blocks=(*BY_SETPOINTS.blocks, Block(Manoeuvre("motors", 0.06), 2.0))
    )
    with pytest.raises(InputError, match=r"mine\.toml"):
        session.record("udp://127.0.0.1:9", tmp_path, shaken, 1)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_flight_plan_is_flown_with_its_yaw(tmp_path, monkeypatch):
    asked = []
    go_to = Crazyflie.go_to

    def noted(self, place, yaw=0.0, motion=None):
        asked.append((*place, yaw))
        go_to(self, place, yaw, motion)

    monkeypatch.setattr(Crazyflie, "go_to", noted)
    (flight,) = flown(FakeDrone(), tmp_path, session.of_flight_plan(BY_SETPOINTS))
    assert flight.ending.reason == COMPLETE
    yaws = np.array(asked)[:, 3]
    assert set(np.unique(yaws)) == {-0.5, 0.0, 0.5}
    assert yaws[-1] == 0.0
    assert np.sum(yaws == 0.5) == pytest.approx(50, abs=5)


@pytest.mark.slow
def test_names_go_on_and_nothing_is_overwritten(tmp_path):
    (tmp_path / "flight_01.rows").write_text("somebody's\n")
    (flight,) = flown(FakeDrone(), tmp_path, plan(0.5))
    assert flight.name == "flight_02"
    assert (tmp_path / "flight_01.rows").read_text() == "somebody's\n"
    assert flight.log == tmp_path / "flight_02.csv"
    assert '"ended": "complete"' in (tmp_path / "flight_02.csv").read_text()


def test_the_log_holds_what_was_commanded(tmp_path):
    fake, commands = FakeDrone(auto_armed=True), {}

    def note(clock):
        if fake.sent:
            commands[fake.sent[-1][1]] = list(fake.plant.command)

    flown(fake, tmp_path, plan(2.0, steps=0.1), before=note)
    log, _, notes = row_files.to_flight(tmp_path / "flight_01.rows")
    assert "2.1+" in notes[0]
    (read,) = read_flights(tmp_path)
    assert read.command.mean() == pytest.approx(1 / THRUST_TO_WEIGHT, rel=0.05)
    assert np.isclose(np.abs(log.setpoint[:, 2] - 0.5), 0.05, atol=0.001).sum() == pytest.approx(
        100, abs=10
    )
    steady = np.abs(log.position[:, 2] - 0.5) < 0.1
    true = np.array(list(commands.values()))
    nearest = np.abs(log.command[steady][:, None] - true).max(axis=2).min(axis=1)
    assert np.median(nearest) < 0.005


@pytest.mark.parametrize(
    ("fake", "why"),
    [
        ({"battery": 3.5}, "battery at 3.50 V"),
        ({"deck": False}, "Flow deck"),
        ({"settles": False}, "does not settle"),
        ({"tumbled": True}, "tumbled"),
        ({"locked": True}, "locked"),
        ({"spoiled": ("stateEstimate.qx",)}, "not a number"),
        ({"tilted": True}, "tilted by 23 deg"),
        ({"policy": False}, "no policy on board"),
        ({"policy": True, "deaf": ("mf.tilt",)}, r"does not confirm mf\.tilt"),
        ({"policy": True, "code": "12345678"}, "policy deadbeef is on board, not 12345678"),
        ({"policy": True, "propellers": "legacy"}, "built for propellers 2.1\\+.* with legacy"),
        ({"charge": 1}, "it is charging; unplug it"),
        ({"lost_rows": 0.5}, "of rows come"),
        ({"unbalanced": 0b0100}, "propeller test failed on M3"),
    ],
)
def test_an_unfit_drone_does_not_take_off(fake, why, tmp_path):
    made = FakeDrone(
        **{
            name: value
            for name, value in fake.items()
            if name in ("battery", "deck", "settles", "policy")
        }
    )
    for name in ("tumbled", "locked", "spoiled", "deaf", "charge", "lost_rows", "unbalanced"):
        setattr(made, name, fake.get(name, getattr(made, name)))
    if "tilted" in fake:
        made.tilt = 0.4
    expected = Expected(code=fake.get("code", ""), propellers=fake.get("propellers", ""))
    care = session.Care(expected, test_propellers="unbalanced" in fake)
    with pytest.raises(InputError, match=why):
        flown(made, tmp_path, plan(policy="policy" in fake), care=care)
    assert made.off_at == 0.0
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_policy_that_looks_ahead_is_given_the_motion_of_its_set_points(tmp_path):
    fake = FakeDrone(policy=True)
    fake.parameters["mf.ahead"] = 5
    (flight,) = flown(fake, tmp_path, plan(2.0, policy=True))
    assert flight.ending.reason == "complete"
    motions = np.array(fake.motions)
    assert len(motions) == pytest.approx(200, abs=2)
    # On a circle of 0.25 m in 3 s, in whole millimetres a second.
    turn = 2.0 * np.pi / 3.0
    velocity, acceleration = np.split(motions[2:-2], 2, axis=1)
    np.testing.assert_allclose(np.linalg.norm(velocity, axis=1), 0.25 * turn, atol=0.003)
    np.testing.assert_allclose(np.linalg.norm(acceleration, axis=1), 0.25 * turn**2, atol=0.02)
    inwards = np.cross(velocity, acceleration)[:, 2]
    np.testing.assert_allclose(np.abs(inwards), 0.0625 * turn**3, atol=0.02)


def test_a_drone_that_does_not_arm_stays_on_the_ground(tmp_path):
    fake = FakeDrone()
    fake.refuses = True
    (flight,) = flown(fake, tmp_path, plan())
    assert "does not arm" in flight.ending.reason
    assert fake.off_at == 0.0


@pytest.mark.slow
def test_a_second_flight_needs_a_fit_drone_too(tmp_path):
    fake, said = FakeDrone(), []

    def drain(clock):
        if (tmp_path / "flight_01.csv").exists():
            fake.battery = 3.6

    assert len(flown(fake, tmp_path, plan(0.5), plan(0.5), said=said, before=drain)) == 1
    assert any("no further flight: battery" in text for text in said)


@pytest.mark.parametrize(("given", "counts"), [(None, 60000), (65535.0, 65535)])
@pytest.mark.slow
def test_the_policy_flies_between_take_off_and_landing(tmp_path, given, counts):
    """With the counts of its own app, unless others are given."""
    fake, active = FakeDrone(policy=True), []

    def note(clock):
        active.append((fake.active, fake.plant.position[2]))

    asked = dataclasses.replace(plan(1.0, policy=True), full_scale_counts=given)
    (flight,) = flown(fake, tmp_path / "flown", asked, before=note)
    assert flight.ending.reason == COMPLETE
    assert entries(tmp_path) == {("fly", "flown"): {"logs"}}
    assert sum(on for on, _ in active) == pytest.approx(100, abs=3)
    assert all(height > 0.4 for on, height in active if on)
    assert fake.parameters["mf.enable"] == 0
    assert (fake.parameters["mf.task"], fake.parameters["mf.full"]) == (2, counts)
    assert (fake.parameters["mf.x"], fake.parameters["mf.y"]) == pytest.approx((0.0, 0.0), abs=0.01)


@pytest.mark.slow
def test_limits_of_a_session_before_are_set_anew_and_recorded_with_the_drone(tmp_path):
    fake, said = FakeDrone(policy=True), []
    tighter = session.Course("hover", 0.5, 0.5, 0.0, policy=True, on_board={"mf.distance": 0.2})
    care = session.Care(Expected(code="deadbeef"), test_propellers=True)
    (flight,) = flown(fake, tmp_path, tighter.plan(0), said=said, care=care)
    assert flight.ending.reason == COMPLETE
    wanted = {**LIMITS, "mf.distance": 0.2, "mf.time": 2.5}
    assert {name: fake.parameters[name] for name in wanted} == pytest.approx(wanted)
    order = [body.split(b"\0")[2] for port, way, body in fake.heard if (port, way) == (2, 3)]
    last = len(order) - order[::-1].index(b"enable") - 1
    assert order.index(b"distance") < last
    assert flight.log is not None
    settings = results.read_record(flight.log)["settings"]
    assert settings["drone"] == "00000012000000abffffffff"
    assert (settings["firmware"], settings["on_board"]) == ("2a18fc299d7b", "deadbeef")
    assert any(line.split()[:2] == ["propellers", "balanced"] for line in said)


def test_a_limit_that_is_not_confirmed_in_flight_ends_it(tmp_path):
    fake = FakeDrone(policy=True)
    fake.at(4.0, lambda fake: setattr(fake, "deaf", ("mf.x",)))
    (flight,) = flown(fake, tmp_path, plan(1.0, policy=True))
    assert flight.ending.reason == "the drone does not confirm mf.x"
    assert (fake.parameters["mf.enable"], fake.down) == (0, True)


def test_no_limit_is_looser_than_the_app_s_own():
    for looser in ({"mf.tilt": 31.0}, {"mf.distance": 0.0}):
        with pytest.raises(InputError, match="the limit of the app on board"):
            session.Course(policy=True, on_board=looser).plan(0)
    with pytest.raises(InputError, match=r"mf\.time = 122"):
        session.Course(duration=120.0, policy=True).plan(0)


def test_nobody_takes_off_without_a_confirmation(tmp_path):
    fake, said = FakeDrone(), []
    assert (
        flown(fake, tmp_path, plan(), said=said, care=session.Care(confirmed=lambda stops: False))
        == []
    )
    assert said[-1] == "no flight: not confirmed"
    assert (fake.off_at, list(tmp_path.iterdir())) == (0.0, [])


@pytest.mark.slow
def test_a_policy_whose_guards_hand_back_is_landed(tmp_path):
    fake = FakeDrone(policy=True)
    fake.at(6.0, lambda fake: (setattr(fake, "active", 0), setattr(fake, "why", 4)))
    (flight,) = flown(fake, tmp_path, plan(3.0, policy=True))
    assert flight.ending.reason == "the controller on board handed back to the PID (distance)"
    assert fake.parameters["mf.enable"] == 0
    assert fake.down


def test_a_policy_that_was_left_on_does_not_take_off(tmp_path):
    fake, heights = FakeDrone(policy=True), []
    fake.parameters["mf.enable"] = fake.active = 1

    def note(clock):
        heights.append(fake.plant.position[2] if fake.active else 0.0)

    (flight,) = flown(fake, tmp_path, plan(0.5), before=note)
    assert flight.ending.reason == COMPLETE
    assert max(heights) == 0.0


def test_ctrl_c_before_take_off_leaves_it_on_the_ground(tmp_path):
    fake, asked = FakeDrone(), []

    def late(clock):
        if any("battery" in text for text in said):
            asked[:] = [1]

    said: list[str] = []
    (flight,) = flown(fake, tmp_path, plan(), stops=lambda: len(asked), said=said, before=late)
    assert flight.ending.reason == "stopped by hand"
    assert fake.off_at == 0.0


def test_ctrl_c_during_the_checks_flies_nothing(tmp_path):
    said: list[str] = []
    assert flown(FakeDrone(), tmp_path, plan(), stops=lambda: 1, said=said) == []
    assert said == ["no further flight: stopped by hand"]
    assert not list(tmp_path.iterdir())


def test_no_plan_leaves_the_limits(tmp_path):
    for wrong in (plan(height=1.75), plan(height=0.2), plan(10.0, 1.0, 1.2)):
        with pytest.raises(InputError, match="the reference goes from"):
            session.checked_plan(wrong, Limits())


def test_nobody_at_the_address():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        uri = f"udp://127.0.0.1:{silent.getsockname()[1]}"
        with pytest.raises(InputError, match=r"no answer in 0\.2 s"):
            Crazyflie(uri, Stepped(None), patience=0.2)
    with pytest.raises(InputError, match="no connection"):
        Crazyflie(uri, Stepped(None), patience=10)
    with pytest.raises(InputError, match="no connection"):
        Crazyflie("pigeon://1", Stepped(None), patience=10)


def test_without_cflib_it_is_told_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "cflib.crazyflie", None)
    with pytest.raises(InputError, match=r"\[drone\]"):
        Crazyflie("udp://127.0.0.1:1", Stepped(None))


def test_the_promise_holds_from_the_ceiling():
    down = (Limits().ceiling + flight.UNDER) / flight.CLIMB + flight.LAGGING + flight.STOPPING
    assert max(guard.patience for guard in GUARDS) + down < PROMISED


def test_a_whole_session(tmp_path, monkeypatch):
    said, clock = [], Stepped(FakeDrone())
    monkeypatch.setattr(session, "Crazyflie", lambda *_: clock.connect())
    before = signal.getsignal(signal.SIGINT)
    with clock.fake:
        flights = session.record(
            clock.fake.uri,
            tmp_path / "flights",
            session.Course("hover", duration=0.5, height=0.4, steps=0.0),
            count=2,
            seed=5,
            clock=clock,
            say=said.append,
        )
    assert signal.getsignal(signal.SIGINT) is before
    assert [(flight.name, flight.ending.reason) for flight in flights] == [
        ("flight_01", COMPLETE),
        ("flight_02", COMPLETE),
    ]
    assert entries(tmp_path) == {("fly", "flights"): {"logs"}}
    assert unlisted(tmp_path) == {f"flights/flight_0{number}.rows" for number in (1, 2)}
    assert all(flight.ending.height < 0.05 for flight in flights)
    began = said.index("armed")
    assert said[began : began + 4] == [
        "armed",
        "taking off to 0.4 m",
        "flying for 0.5 s, the PID",
        "landing",
    ]


def test_blocks_of_different_instants_are_interpolated_over_no_more_than_one_packet(tmp_path):
    head = "# maidenflight rows 1: x\n# simulated: no\n# record: {}\n"
    columns = ["timestamp", *STATE.variables, *MOTORS.variables]
    sound = {"stateEstimate.qw": 1.0, "pm.vbatMV": 4000, "controller.cmd_thrust": 30000.0}
    lines = []
    for number in range(60):
        for block, late in ((STATE, 0), (MOTORS, 4)):
            if block is MOTORS and 20 <= number < 30:
                continue
            values = {name: sound.get(name, 0) for name in block.variables}
            if block is MOTORS:
                values |= {f"motor.m{motor}": 40000 + 100 * number for motor in (1, 2, 3, 4)}
            row = {"timestamp": 10 * number + late, **values}
            lines.append(",".join(str(row.get(name, "")) for name in columns))
    (tmp_path / "flight_01.rows").write_text(
        head + ",".join(columns) + "\n" + "\n".join(lines) + "\n"
    )
    flight, _, _ = row_files.to_flight(tmp_path / "flight_01.rows")
    known = np.isfinite(flight.command[:, 0])
    # The first row has no motors before it; that of 190 ms has a packet before it only, those up to
    # 290 ms before the next.
    assert np.flatnonzero(~known).tolist() == list(range(19, 30))
    shared = thrust_command(np.full((1, 4), 40000 + 100 * 9.6), np.array([4.0]))
    assert flight.command[9] == pytest.approx(shared[0], abs=1e-5)


KILLED = """
import os, signal, sys
from pathlib import Path
sys.path[:0] = [sys.argv[1], str(Path(sys.argv[1]).parents[1] / "common")]
from fake_drone import FakeDrone
from test_session import flown, plan
def die(clock):
    if clock.link.latest and clock.link.latest.position[2] > 0.45 and clock.fake.time > 5:
        os.write(1, str(len([1 for number, _ in clock.fake.sent[first:] if number < 3])).encode())
        os.kill(os.getpid(), signal.SIGKILL)
first = 0
class Said(list):
    def append(self, text):
        global first
        if text.startswith("flight_01: battery"):
            first = len(fake.sent)
fake = FakeDrone()
flown(fake, Path(sys.argv[2]), plan(3.0), said=Said(), before=die)
"""


@pytest.mark.slow
def test_a_killed_program_leaves_every_row(tmp_path):
    ran = subprocess.run(
        [sys.executable, "-c", KILLED, Path(__file__).parent, tmp_path],
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert ran.returncode == -signal.SIGKILL, ran.stderr
    kept = (tmp_path / "flight_01.rows").read_text().splitlines()
    assert len(kept) - 4 == int(ran.stdout) > 300
    assert not (tmp_path / "flight_01.csv").exists()
    made, refused = row_files.recover(tmp_path)
    assert (made, refused) == ([tmp_path / "flight_01.csv"], [])
    assert read_flights(tmp_path).duration > 1.0
    assert row_files.recover(tmp_path) == ([], [])


@pytest.mark.slow
def test_lost_packets_leave_gaps_and_no_inventions(tmp_path):
    fake = FakeDrone(seed=4)
    fake.at(5.0, lambda fake: setattr(fake, "lost_rows", 1.0))
    fake.at(5.2, lambda fake: setattr(fake, "lost_rows", 0.0))
    flown(fake, tmp_path, plan(2.0))
    flight, record, _ = row_files.to_flight(tmp_path / "flight_01.rows")
    missing = np.flatnonzero(np.isnan(flight.position[:, 0]))
    assert len(missing) == pytest.approx(20, abs=2)
    assert np.ptp(missing) == len(missing) - 1
    assert np.isnan(flight.command[missing]).all()
    assert np.isnan(flight.command).any(axis=1).sum() == pytest.approx(20, abs=4)
    assert len(read_flights(tmp_path)) == 2
    assert (record["seed"], record["settings"]["task"], record["settings"]["deck"]) == (
        3,
        "circle",
        "deck.bcFlow2",
    )


def test_rows_that_are_no_flight_are_refused(tmp_path):
    (tmp_path / "flight_01.rows").write_text("x\n1\n")
    cut = (
        "# maidenflight rows 1: x\n# simulated: no\n# record: {}\n"
        + ",".join(["timestamp", *STATE.variables, *MOTORS.variables])
        + "\n"
    )
    (tmp_path / "flight_02.rows").write_text(cut + "1," + "," * 19 + "\n")
    made, refused = row_files.recover(tmp_path)
    assert made == []
    assert "line 1 is not" in refused[0]
    assert "too few" in refused[1]
