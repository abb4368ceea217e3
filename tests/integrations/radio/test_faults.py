"""Whatever goes wrong in flight, at a random moment: the motors stop in the promised time, and
every row that came is on disk."""

import contextlib
import math
import os
import random
import re
import signal
from pathlib import Path

import pytest

pytest.importorskip("cflib")

from fake_drone import FakeDrone, Stepped

from maidenflight import results
from maidenflight.errors import InputError
from maidenflight.flights import tables
from maidenflight.integrations.radio import session
from maidenflight.integrations.radio.flight import COMPLETE, PROMISED, Plan
from maidenflight.simulator.tasks import trajectories

pytestmark = pytest.mark.slow

PATH = trajectories.circle(0.5, 3.0, 1.0)
SECONDS = 1.0
IN_AIR = 6.0
"""From arming to the ground, at least [s]."""
LED = 3.2
"""From arming until the landing begins, at least [s]."""
FIRMWARE_STOPS = 2.0
"""Time without set-points after which the firmware stops the motors [s]. Source: firmware 2026.08,
commander.h."""


def setting(**values):
    def misbehave(fake):
        for name, value in values.items():
            setattr(fake, name, value)

    return misbehave


def plant(**values):
    def misbehave(fake):
        for name, value in values.items():
            setattr(fake.plant, name, value)

    return misbehave


def briefly(misbehave, undo, seconds):
    def both(fake):
        misbehave(fake)
        fake.at(fake.time + seconds, undo)

    return both


QUATERNION = tuple(f"stateEstimate.q{name}" for name in "xyzw")
DRONE = {
    "a third of the rows is lost": (setting(lost_rows=0.33), COMPLETE),
    "half the commands are lost": (setting(lost_commands=0.5), COMPLETE),
    "rows come twice and in the wrong order": (setting(copies=2, late=3), COMPLETE),
    "no rows for 0.3 s": (briefly(setting(lost_rows=1.0), setting(lost_rows=0.0), 0.3), COMPLETE),
    "no row any more": (setting(lost_rows=1.0), "no rows"),
    "no command arrives any more": (setting(lost_commands=1.0), "stopped the motors|set-point"),
    "nothing arrives any more": (setting(lost_rows=1.0, lost_commands=1.0), "no rows"),
    "switched off": (FakeDrone.vanish, "link lost|no rows"),
    "not a number": (setting(spoiled=QUATERNION), "not a number"),
    "not a number for 50 ms": (
        briefly(setting(spoiled=QUATERNION), setting(spoiled=()), 0.05),
        COMPLETE,
    ),
    "battery empty": (setting(battery=2.9), "battery"),
    "battery reads 0 V for 0.1 s": (
        briefly(setting(battery=0.3), setting(battery=4.0), 0.1),
        COMPLETE,
    ),
    "tumbled": (setting(tumbled=True), "tumbled"),
    "disarmed": (setting(armed=False), "disarmed"),
    "locked": (setting(locked=True), "locked"),
    "the estimate leaps by a metre": (setting(leap=1.0), "set-point"),
    "a gust": (plant(gust=7.0), "set-point|tilt|take-off"),
    "a motor fails": (plant(dead_motor=2), "tilt|set-point|handed back"),
}


def interrupt(clock):
    signal.raise_signal(signal.SIGINT)


def interrupt_twice(clock):
    interrupt(clock)
    interrupt(clock)


def fail(clock):
    raise RuntimeError("a defect of the program")


def without_handler(clock):
    raise KeyboardInterrupt


def fill_disk(clock):
    full = os.open("/dev/full", os.O_WRONLY)
    os.dup2(full, clock.link._rows._descriptor)
    os.close(full)


PROGRAM = {
    "Ctrl-C": (interrupt, "by hand"),
    "Ctrl-C twice": (interrupt_twice, "at once by hand"),
    "Ctrl-C without a handler": (without_handler, "by hand"),
    "an error of the program": (fail, "a defect"),
    "disk full": (fill_disk, "could no longer be written"),
}


class Flight:
    """A short flight of the fake drone, and what came of it."""

    def __init__(self, folder, seed, policy=False):
        self.folder, self.random, self.fake = (
            folder,
            random.Random(seed),
            FakeDrone(seed, policy=policy),
        )
        self.clock = Stepped(self.fake)
        self.plan = Plan(session.reference(PATH, SECONDS, 0.5, 0.05, seed), policy)
        self.first, self.last, self.moment, self.reason, self.armed_at = -1, 0, math.inf, "", 0.0
        self.moment_after = self.random.uniform(0.0, IN_AIR)

    def fly(self, misbehave=None, interfere=None):
        """Flies with something that goes wrong on the drone's side or on the program's."""

        def say(text):
            if text.startswith("flight_01: battery") and self.first < 0:
                self.first = len(self.fake.sent)
            if text == "armed":
                self.armed_at = self.fake.time
                self.moment = self.fake.time + self.moment_after
                if misbehave:
                    self.fake.at(self.moment, misbehave)
                if interfere:
                    self.clock.before.append(once)
            if "packets" in text:
                self.last = len(self.fake.sent)

        def once(clock):
            if interfere and self.fake.time >= self.moment:
                self.clock.before.remove(once)
                interfere(clock)

        with (
            self.fake,
            contextlib.closing(self.clock.connect()) as link,
            session.stop_requests() as stops,
        ):
            try:
                (flown,) = session.flights(
                    link,
                    [self.plan],
                    self.folder,
                    results.record(seed=0, inputs=[], settings={}),
                    clock=self.clock,
                    stops=stops,
                    say=say,
                )
                self.reason = flown.ending.reason
            except (InputError, RuntimeError) as error:
                self.reason = str(error)
            except KeyboardInterrupt:
                self.reason = "by hand, in the landing"
            self.last = self.last or len(self.fake.sent)
            self.clock.before.clear()
            self.ended_at, self.left_turning = self.fake.time, self.fake.plant.turning
            if self.left_turning:
                self.clock.sleep(FIRMWARE_STOPS + 0.5)
            self.motors_on = self.fake.plant.turning
        return self

    def on_disk(self):
        """Time stamps of the rows in the file, in their order."""
        table = tables.read(self.folder / "flight_01.rows", "rows")
        return [int(stamp) for stamp in table.frame["timestamp"]]

    def sent(self):
        """Time stamps of the rows of both fast blocks that the drone sent while the flight
        lasted."""
        return [
            stamp for number, stamp in self.fake.sent[self.first : self.last] if number in (1, 2)
        ]


SOFTEST = 1.2
"""Fastest touch-down of a landing [m/s]: the motors stop 4 cm above the ground. A fall from this
flight's height ends with 3."""
FALLS = {
    "no command arrives any more",
    "nothing arrives any more",
    "switched off",
    "not a number",
    "tumbled",
    "disarmed",
    "locked",
}
AT_LAST = {"Ctrl-C without a handler", "an error of the program"}
"""Where it may fall if they come in the landing."""
FALLS |= AT_LAST | {"a gust", "a motor fails", "Ctrl-C twice"}
"""Where the drone may fall."""


def check(flight, wanted, name):
    assert not flight.motors_on
    if "arrives any more" not in name:
        assert not flight.left_turning
    if name not in FALLS or (name in AT_LAST and flight.moment_after < LED - 0.5):
        assert flight.fake.plant.impact < SOFTEST
    assert flight.fake.off_at - flight.moment <= PROMISED if wanted != COMPLETE else True
    assert flight.ended_at - flight.armed_at < IN_AIR + PROMISED + 3
    if wanted == COMPLETE:
        assert flight.reason == COMPLETE
    elif flight.moment_after < LED - (2.8 if wanted.startswith("stopped the motors") else 0.5):
        assert flight.reason != COMPLETE
        assert re.search(wanted, flight.reason)


@pytest.mark.parametrize("name", DRONE)
def test_the_motors_stop_whatever_the_drone_does(name, tmp_path):
    misbehave, wanted = DRONE[name]
    flight = Flight(tmp_path, seed=list(DRONE).index(name)).fly(misbehave=misbehave)
    check(flight, wanted, name)
    assert flight.on_disk() == flight.sent()


@pytest.mark.parametrize("name", PROGRAM)
def test_the_motors_stop_whatever_happens_to_the_program(name, tmp_path):
    if name == "disk full" and not Path("/dev/full").exists():
        pytest.skip("there is no /dev/full here")
    interfere, wanted = PROGRAM[name]
    flight = Flight(tmp_path, seed=100 + list(PROGRAM).index(name)).fly(interfere=interfere)
    check(flight, wanted, name)
    kept = flight.on_disk()
    assert kept == flight.sent()[: len(kept)]
    if name == "disk full":
        assert len(kept) > 2 * 100 * (flight.moment_after - 0.1)
    else:
        assert len(kept) == len(flight.sent())
