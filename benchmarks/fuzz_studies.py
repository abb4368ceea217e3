"""Reader of studies, for the fuzzer."""

from typing import Any

import numpy as np
from fuzz_damage import ANY, Kind
from fuzz_reader import Good, Reader, toml, tree_damaged

from maidenflight.studies import study as studies
from maidenflight.studies.study import Study

STUDY = b"""# A study.
[[task]]
name = "policy"
kind = "train"
[task.settings]
control = "attitude"
drone = "crazyflie"
randomize = 0.1
policies = 3
updates = 600
rate = 100
hidden = [50, 50]
paper_scales = true
learner = { horizon = 32, learning_rate = 0.003 }
[task.grid]
"set.motor_time_constant" = [0.04, 0.08]
seed = [0, 1]

[[task]]
name = "flown"
kind = "transfer"
inputs = { policies = "policy" }
[task.settings]
reality = ["near:7", "virtual:7"]
trials = 3
duration = 20.0
"""
RANGES = {
    "policies": (1, 4096),
    "updates": (1, 10**6),
    "rate": (1, 1000),
    "trials": (1, 1000),
    "duration": (0.1, 600.0),
    "seed": (0, 2**31 - 1),
}
"""Of numbers among the settings of a study."""


def to_arrays(read: Study) -> list[np.ndarray]:
    """Returns the tasks of a study for comparison."""
    return [np.array([repr(task) for task in read.tasks])]


def unsound_study(read: Study) -> str:
    """Checks that tasks follow those that they take, and numbers of settings are in range."""
    made: set[str] = set()
    for task in read.tasks:
        if not made >= set(task.inputs.values()):
            return f"{task.label} takes what no earlier task makes"
        made.add(task.key)
        for name, (low, high) in RANGES.items():
            value = task.settings.get(name)
            taken = isinstance(value, int | float) and low <= value <= high
            if value is not None and (isinstance(value, bool) or not taken):
                return f"{name} = {value}"
        for name in ("set", "learner"):
            if not np.isfinite(list(task.settings.get(name, {}).values())).all():
                return f"{name} = {task.settings[name]}"
    return ""


def _study_needs(path: tuple[Any, ...]) -> bool:
    entry = path[:1] == ("task",) and path[2:] in (("name",), ("kind",), ("inputs", "policies"))
    return entry or path == ("task",)


def study_reader() -> Reader:
    """Of a study."""
    return Reader(
        "study, TOML",
        8,
        (Good("study.toml", STUDY, tree_damaged(toml, _study_needs, "toml", Kind(ANY))),),
        lambda _, path: studies.read_study(path),
        to_arrays,
        unsound_study,
    )
