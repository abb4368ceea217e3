"""How much estimates depend on constants that name no source: each times 0.7 and times 1.4.

Virtual drones of three worlds fly short circles and are identified with constants changed, several
at once; groups whose estimates move are halved until each is known. What counts is the largest
movement of any estimate and of any end of an interval, over half the width of its 95 % interval; a
parameter that is identified only before or only after counts as infinite. A constant is harmless
within a factor of 1.4 where no estimate moves by more than a tenth and no end, which is found from
some hundred samples, by more than a fifth. A constant that no log needs is not judged.

A share between 0.5 and 1 changes its distance from 1, whole numbers are rounded, and of several
numbers all change together. Each trial runs in a process of its own, into whose modules
the changes are written as they are imported; what has been tried is not tried again.

    python paper/identification/constants.py -o constants
    python paper/identification/constants.py --only search. --logs "virtual, replay"
"""

import argparse
import ast
import importlib
import json
import os
import pickle
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.machinery import SourceFileLoader
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import polars

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
parts: Any = importlib.import_module("parts")

FACTORS = (0.7, 1.4)
MOST_ESTIMATE, MOST_END = 0.1, 0.2
LOGS = {
    "near, state": ("near:901", 100, False, True),
    "virtual, no state": ("virtual:902", 250, False, False),
    "far, state, speeds": ("far:903", 500, True, True),
    "virtual, state": ("virtual:902", 250, False, True),
    "virtual, no state, speeds": ("virtual:904", 500, True, False),
    "virtual, replay": ("virtual:905", 100, False, True),
}
"""By name the drone, rows a second, and whether rotor speeds and a state are logged."""
FLIGHTS, DURATION, FULL_SPEED = 3, 10.0, 2500.0
"""Flights of a drone, how long each is [s], and speed of rotors at full thrust [rad/s]."""
OWN = "paper/identification/constants.py"


class Movement(NamedTuple):
    """How far results move, in half intervals, and which parameter's do most."""

    estimate: float
    end: float
    parameter: str

    @property
    def is_harmless(self) -> bool:
        """Whether it is within what counts as none."""
        return self.estimate <= MOST_ESTIMATE and self.end <= MOST_END


def scaled(value: Any, factor: float) -> Any:
    """Changes all numbers of a constant."""
    if isinstance(value, bool | str | slice) or value is None:
        return value
    if isinstance(value, Mapping):
        return {key: scaled(each, factor) for key, each in value.items()}
    if isinstance(value, tuple):
        changed = [scaled(each, factor) for each in value]
        return type(value)(*changed) if hasattr(value, "_fields") else tuple(changed)
    if isinstance(value, int):
        return value if abs(value) < 2 else round(value * factor)
    if isinstance(value, float) and 0.5 < value < 1:
        return 1 - (1 - value) * factor
    return value * factor


class _Uses(ast.NodeTransformer):
    """Wraps each use of constants, so that it is known which a run needs."""

    def __init__(self, module: str, names: Sequence[str]) -> None:
        self.called = dict[str, str]()
        for name in names:
            owner, _, target = name.partition(": ")
            for constant in target.strip("()").split(", "):
                if owner == module:
                    self.called[constant] = name
                for alias, full in parts.modules()[module].imports.items():
                    if full == f"{owner}.{constant}":
                        self.called[alias] = name
                    if full == owner:
                        self.called[f"{alias}.{constant}"] = name

    def _wrap(self, node: Any) -> Any:
        name = self.called.get(ast.unparse(node)) if isinstance(node.ctx, ast.Load) else None
        if name is None:
            return self.generic_visit(node)
        use = f"__import__('__main__').used({name!r}, {ast.unparse(node)})"
        return ast.parse(use, mode="eval").body

    visit_Name = visit_Attribute = _wrap


USED = set[str]()


def used(name: str, value: Any) -> Any:
    """Notes that a run needs a constant; returns its value."""
    USED.add(name)
    return value


def change_imports(factors: Mapping[str, float], watched: Sequence[str]) -> None:
    """Changes constants of modules that are imported from here on, and notes uses of others."""
    read: Any = SourceFileLoader.get_code

    def get_code(loader: Any, module: str) -> Any:
        if module not in parts.modules():
            return read(loader, module)
        tree = ast.parse(loader.get_data(loader.path))
        if watched:
            tree = _Uses(module, watched).visit(tree)
        mine = {
            name.partition(": ")[2].strip("()"): factor
            for name, factor in factors.items()
            if name.partition(": ")[0] == module
        }
        body = []
        for node in tree.body:
            body.append(node)
            target = ""
            if isinstance(node, ast.Assign | ast.AnnAssign):
                first = node.targets[0] if isinstance(node, ast.Assign) else node.target
                target = ast.unparse(first).strip("()")
            if target in mine:
                change = f"__import__('__main__').scaled(({target}), {mine.pop(target)})"
                body += ast.parse(f"{target} = {change}").body
        assert not mine, f"{module} lacks {mine}"
        tree.body = body
        return compile(ast.fix_missing_locations(tree), loader.path, "exec")

    setattr(SourceFileLoader, "get_code", get_code)  # noqa: B010


def fly(log: str) -> Any:
    """Returns the flights of a log."""
    import jax

    from maidenflight.experiments.drones import find_reality
    from maidenflight.flying.engine import fly_all
    from maidenflight.flying.firmware_pilot import FirmwarePilot
    from maidenflight.flying.recording import flight_log
    from maidenflight.flying.scenario import Scenario
    from maidenflight.simulator.tasks.tasks import paper_circle

    drone, rate, has_speeds, has_state = LOGS[log]
    keys = jax.random.split(jax.random.key(0), FLIGHTS)
    scenario, pilot = Scenario(paper_circle(), DURATION), FirmwarePilot(np.float32(0.06))
    flights = []
    for number, simulated in enumerate(fly_all(find_reality(drone), pilot, scenario, keys)):
        flight = flight_log(simulated, f"flight_{number}", rate, keys[number])
        if has_speeds:
            speed = FULL_SPEED * np.asarray(simulated.rows.rotor_speed)[: len(flight)]
            flight = replace(flight, rotor_speed=speed.astype(np.float32))
        if not has_state:
            lost = np.full_like(flight.position, np.nan)
            flight = replace(flight, position=lost, velocity=lost, attitude=lost)
        flights.append(flight)
    return flights


def trial(log: str, factors: Mapping[str, float], watched: Sequence[str], folder: Path) -> None:
    """Identifies with constants changed; prints estimates and which constants were used."""
    change_imports(factors, watched)
    import maidenflight as mf

    path = folder / f"{log}.pickle"
    if not path.exists():
        path.write_bytes(pickle.dumps(fly(log)))
    settings = mf.Replay() if "replay" in log else mf.Likelihood()
    found = mf.identify(pickle.loads(path.read_bytes()), settings, key=0)
    estimates = {
        name: (float(each.value), *map(float, each.interval))
        for name, each in found.estimates.items()
    }
    print(json.dumps({"estimates": estimates, "used": sorted(USED)}))


class Trials:
    """What has been tried, in a file of a line each."""

    def __init__(self, folder: Path) -> None:
        """Reads what was tried before."""
        self.folder, self.path, self.done = folder, folder / "trials.jsonl", dict[str, Any]()
        folder.mkdir(parents=True, exist_ok=True)
        if self.path.exists():
            for line in self.path.read_text().splitlines():
                self.done.update(json.loads(line))

    def run(self, log: str, factors: Mapping[str, float], watched: Sequence[str] = ()) -> Any:
        """Returns what one trial printed, or its error."""
        key = json.dumps([log, sorted(factors.items())])
        if key not in self.done:
            request = json.dumps([log, dict(factors), list(watched)])
            command = [sys.executable, __file__, "-o", str(self.folder), "--trial", request]
            cache = {
                "JAX_COMPILATION_CACHE_DIR": str(self.folder.resolve() / "programs"),
                "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
            }
            ended = subprocess.run(
                command, capture_output=True, text=True, check=False, env=os.environ | cache
            )
            lines = (ended.stderr if ended.returncode else ended.stdout).splitlines()
            self.done[key] = {"error": lines[-1]} if ended.returncode else json.loads(lines[-1])
            with self.path.open("a") as file:
                file.write(json.dumps({key: self.done[key]}) + "\n")
        return self.done[key]


def movement(before: Any, after: Any) -> Movement:
    """Returns how far results of a trial are from those of the one without a change."""
    if "error" in after:
        return Movement(np.inf, np.inf, after["error"])
    before, after, largest = before["estimates"], after["estimates"], Movement(0.0, 0.0, "")
    for name in before.keys() | after.keys():
        if name not in before or name not in after:
            return Movement(np.inf, np.inf, f"{name} {'found' if name in after else 'lost'}")
        values = np.array(before[name])
        moved = np.abs(np.array(after[name]) - values) / ((values[2] - values[1]) / 2)
        here = Movement(float(moved[0]), float(moved[1:].max()), name)
        largest = max(largest, here, key=lambda each: max(each[0], each[1] / 2))
    return largest


def judge(
    trials: Trials, log: str, names: Sequence[str], factor: float
) -> Iterator[tuple[str, Movement]]:
    """Yields for each constant the movement that it causes at most."""
    moved = movement(trials.run(log, {}), trials.run(log, dict.fromkeys(names, factor)))
    if len(names) == 1 or moved.is_harmless:
        yield from ((name, moved) for name in names)
        return
    for half in (names[: len(names) // 2], names[len(names) // 2 :]):
        yield from judge(trials, log, half, factor)


def known(trials: Trials, log: str, factor: float) -> dict[str, Movement]:
    """Returns the movements that earlier trials of a log tell, whatever their groups were."""
    movements = {}
    for key, found in trials.done.items():
        where, factors = json.loads(key)
        if where == log and factors and all(each == factor for _, each in factors):
            moved = movement(trials.run(log, {}), found)
            if len(factors) == 1 or moved.is_harmless:
                movements |= {name: moved for name, _ in factors}
    return movements


def candidates(prefix: str) -> list[str]:
    """Returns the constants whose note names no source, or this script alone."""
    own, parts.SOURCE = parts.SOURCE, _WithoutOwn(parts.SOURCE)
    names = [name for name in parts.constants()[1] if name.startswith(prefix)]
    parts.SOURCE = own
    return names


class _WithoutOwn(NamedTuple):
    """A pattern that passes over the name of this script."""

    pattern: Any

    def search(self, note: str) -> Any:
        return self.pattern.search(note.replace(OWN, ""))


def main() -> None:
    """Writes the table and prints it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("prefix", nargs="?", default="maidenflight.identification")
    parser.add_argument("--only", nargs="*", default=[""], help="parts of names, of which one is")
    parser.add_argument("--skip", nargs="*", default=[], help="parts of names, of which none is")
    parser.add_argument("--logs", nargs="*", choices=LOGS, default=LOGS)
    parser.add_argument("--at-once", type=int, default=16, help="constants of a first group")
    parser.add_argument("-o", "--output", type=Path, default=Path("constants"))
    parser.add_argument("--trial", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.trial:
        log, factors, watched = json.loads(options.trial)
        trial(log, factors, watched, options.output)
        return
    every, trials, rows = candidates(options.prefix), Trials(options.output), []
    names = [name for name in every if any(part in name for part in options.only)]
    names = [name for name in names if not any(part in name for part in options.skip)]
    for log in options.logs:
        needed = set(trials.run(log, {}, every)["used"])
        for factor in FACTORS:
            movements = known(trials, log, factor)
            print(f"{log}, times {factor}: {len(movements)} known", file=sys.stderr, flush=True)
            left = [name for name in names if name in needed and name not in movements]
            for first in range(0, len(left), options.at_once):
                movements |= judge(trials, log, left[first : first + options.at_once], factor)
            rows += [
                {"constant": name, "log": log, "factor": factor, **moved._asdict()}
                for name, moved in movements.items()
                if name in names
            ]
    table = polars.DataFrame(rows).sort("estimate", "end", descending=True)
    table.write_csv(options.output / "constants.csv")
    worst = table.group_by("constant", maintain_order=True).first()
    with polars.Config(tbl_rows=-1, tbl_hide_dataframe_shape=True, fmt_str_lengths=80):
        print(worst)


if __name__ == "__main__":
    main()
