"""Each guard of the app trips in flight within 100 ms of its fault, and hands back to the PID.

`plant/guards.py` flies 30 times 20 s without a fault, in which none must trip.
"""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from app_in_firmware import COMPILERS, App
from app_in_plant import Fault, Loop, Pid, app_for, sprightly

from maidenflight.integrations.radio.blocks import REASONS
from maidenflight_plant.running_plant import RunningPlant

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not COMPILERS or not shutil.which("make"), reason="no C compiler or no make on this machine"
    ),
]
BEGUN_S, PROMISED_S, LONGEST_S = 0.2, 0.1, 0.9
"""When a fault is let loose after the hand-over, and by when it must have been answered [s]."""
Fly = Callable[[Fault], tuple[float, str]]


@pytest.fixture(scope="module")
def fly(tmp_path_factory: pytest.TempPathFactory) -> Fly:
    """Flies with a fault; the time that the policy flies, and why no longer."""
    drone, pid = sprightly(1), Pid()
    library = Path(app_for(drone, tmp_path_factory.mktemp("app")).library._name)

    def flown(fault: Fault) -> tuple[float, str]:
        copy = tmp_path_factory.mktemp("flown") / "app.so"
        copy.write_bytes(library.read_bytes())
        app = App(copy)
        app.set(task=2)
        seconds = Loop(app, RunningPlant(drone, 1, 60000.0), pid).fly(LONGEST_S, fault)
        return seconds, REASONS[int(app.log("why"))]

    return flown


def tired(loop: Loop) -> bool:
    """The battery gives way."""
    loop.sag = 1.5
    return True


def displaced(loop: Loop) -> bool:
    """The position's sensor says from then on that the drone is elsewhere."""
    loop.offset = np.array([0.5, 0.0, 0.0])
    return True


def leapt(loop: Loop) -> bool:
    """The estimated velocity leaps."""
    loop.velocity += 0.0 if loop.leapt else np.array([0.0, 0.8, 0.0])
    loop.leapt = True
    return True


def led_away(loop: Loop) -> bool:
    """Set-points lead the drone through the fence."""
    loop.app.set(fence=0.1)
    loop.wanted[0] = 0.5
    return abs(loop.position[0]) > 0.1


def led_up(loop: Loop) -> bool:
    """Set-points lead the drone through the ceiling."""
    loop.app.set(ceiling=1.1)
    loop.wanted[2] = 1.5
    return loop.position[2] > 1.1


def late(loop: Loop) -> bool:
    """The time is up."""
    loop.app.set(time=BEGUN_S)
    return True


FAULTS: dict[str, Callable[[Loop], bool]] = {
    "battery": tired,
    "estimate against accelerometer": displaced,
    "fence": led_away,
    "ceiling": led_up,
    "time": late,
}


def test_a_flight_without_a_fault_is_flown_to_its_end(fly: Fly) -> None:
    assert fly(lambda loop, time: None) == (LONGEST_S, "nothing")


@pytest.mark.parametrize("change", [*FAULTS.values(), leapt])
def test_a_fault_hands_back_within_a_tenth_of_a_second(
    fly: Fly, change: Callable[[Loop], bool]
) -> None:
    since: list[float] = []

    def fault(loop: Loop, time: float) -> None:
        if time >= BEGUN_S and change(loop):
            since.append(time)

    seconds, why = fly(fault)
    known = {made: name for name, made in FAULTS.items()}
    assert why == known.get(change, "estimate against accelerometer")
    # What trips in the step in which the fault comes true leaves no step in which to note it.
    assert BEGUN_S <= seconds <= (since or [LONGEST_S])[0] + PROMISED_S
    assert seconds < LONGEST_S
