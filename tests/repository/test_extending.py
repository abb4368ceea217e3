"""In how many files the library itself is extended: the table of docs/extending.md, by doing it."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import maidenflight
from made_flights import driven
from maidenflight.flights import flight_csv

SOURCE = Path(maidenflight.__file__).parent
PAGE = Path(__file__).parents[2] / "docs" / "extending.md"
Patches = dict[str, tuple[str, str]]
"""By file, a text and what it is replaced by."""

PARAMETER: Patches = {
    "parameters/quantities.py": (
        "    flapping_moment: Any = _body(",
        '    buoyancy: Any = _body("b [m/s2]", 0.0, (0.0, 5.0), "of a balloon", "a test")\n'
        "    flapping_moment: Any = _body(",
    ),
    "simulator/physics/dynamics.py": (
        "lift[2] - parameters.gravity",
        "lift[2] - parameters.gravity + parameters.buoyancy",
    ),
    "identification/unknowns.py": (
        '    "latency": Unknown(\n',
        '    "buoyancy": Unknown(Ends(0.0, 2.0), Ends(0.0, 1.0), "sink"),\n'
        '    "latency": Unknown(\n',
    ),
}
FLOATS = """
import numpy as np
import maidenflight as mf
from maidenflight import parameters
from maidenflight.identification.unknowns import physical_bounds
from maidenflight.simulator.physics import dynamics

lifted = parameters.replace(mf.crazyflie(), buoyancy=0.5)
parameters.write_drone("lifted.toml", lifted, {})
assert parameters.read_drone("lifted.toml").buoyancy == np.float32(0.5)
state = dynamics.at_hover(np.zeros(3, np.float32), mf.crazyflie())
up = [dynamics.linear_acceleration(state, one)[2] for one in (lifted, mf.crazyflie())]
assert abs(up[0] - up[1] - 0.5) < 1e-5
assert physical_bounds(lifted)["buoyancy"] == (0.0, 2.0)
flights = mf.read_flights("flight.csv")
few = mf.Likelihood(trials=1, evaluations=2)
found = mf.identify(flights, few, over=("latency", "buoyancy"))
assert "buoyancy" in {**found.estimates, **found.unidentified}
"""
TASK: Patches = {
    "simulator/tasks/tasks.py": (
        "TASKS: dict[str,",
        "@cached_by_arguments\ndef high() -> Task:\n"
        '    return hover(2.0)._replace(name="high")\n\n\n'
        "TASKS: dict[str,",
    ),
    "names.py": ('"hover", "take_off")', '"hover", "take_off", "high")'),
}
FLIES = """
import jax
import maidenflight as mf
from maidenflight.policy import untrained_policy
from maidenflight.simulator.tasks.tasks import TASKS
from maidenflight.verbs.train import Train

assert Train(task="high").task == "high"
policies = [untrained_policy(jax.random.key(0))]
flown = mf.transfer(policies, [mf.virtual_drone(7)], task=TASKS["high"]())
assert flown.table.height
"""


COMPLETE = {
    "control structure": ["attitude_rate"],
    "log format": ["ardupilot", "dataflash", "blackbox", "betaflight", "rosbag"],
    "physical parameter": [
        *("motor_coasting", "rotor_momentum", "flapping_moment", "turn_drift"),
        *("thrust_linear", "rotational_damping"),
    ],
}
"""Of each kind, some that were added after the paper's."""


@pytest.mark.parametrize("what", COMPLETE)
def test_the_costliest_additions_are_named_in_no_more_files_than_the_page_says(what: str) -> None:
    (row,) = re.findall(rf"^\| {what} \| \d \((\d+)\)", PAGE.read_text(), re.MULTILINE)
    counts = {
        name: sum(
            re.search(rf"\b{name}\b", path.read_text(), re.IGNORECASE) is not None
            for path in SOURCE.rglob("*.py")
        )
        for name in COMPLETE[what]
    }
    assert max(counts.values()) <= int(row), counts


@pytest.mark.night
@pytest.mark.parametrize(
    ("what", "patches", "program"),
    [("task", TASK, FLIES), ("physical parameter", PARAMETER, FLOATS)],
    ids=["task", "parameter"],
)
def test_the_library_is_extended_in_as_many_files_as_the_page_says(
    what: str, patches: Patches, program: str, tmp_path: Path
) -> None:
    (row,) = re.findall(rf"^\| {what} \| (\d)", PAGE.read_text(), re.MULTILINE)
    assert len(patches) == int(row)
    copy = tmp_path / "src" / "maidenflight"
    shutil.copytree(SOURCE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    for file, (old, new) in patches.items():
        text = (copy / file).read_text()
        assert text.count(old) == 1, file
        (copy / file).write_text(text.replace(old, new))
    flight_csv.write(tmp_path / "flight.csv", driven(900))
    place = os.environ | {"PYTHONPATH": str(copy.parent)}
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, env=place, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
