"""How much results depend on constants that name no source: each times 0.7 and times 1.4.

Virtual drones of three worlds fly short circles, and real ones flew what lies in a folder of data.
They are identified with constants changed, several at once; groups whose estimates move are halved
until each is known. What counts is the largest movement of any estimate and of any end of an
interval, over half the width of its 95 % interval; a parameter that is identified only before or
only after counts as infinite. A constant is harmless within a factor of 1.4 where no estimate moves
by more than a tenth and no end, which is found from some hundred samples, by more than a fifth. A
constant that no log needs is not judged.

Of a plan of flight the intervals are those that it expects, about zero: they become at most a fifth
wider or narrower. Of the closed loop they are those of what policies' flights match. Path flights
are those by which intervals are tested, identified like their log.

A share between 0.5 and 1 changes its distance from 1, whole numbers are rounded, and of several
numbers all change together. Each trial runs in a process of its own, into whose modules
the changes are written as they are imported; what has been tried is not tried again.

    python paper/identification/constants.py -o constants
    python paper/identification/constants.py --only search. --logs "virtual, replay"
    python paper/identification/constants.py --data ../shared/data --logs "closed loop"
"""

import argparse
import ast
import importlib
import json
import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
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
MEASURED = (
    "NanoBench",
    "NanoDrone",
    "brushed",
    "brushless",
    "payload",
    "INDIflight",
    "better_tune",
)
"""Drones of the truth board, of which the first log is read."""
SATURATED = "real/minimal/x1_full_throttle_saturates.bbl"
"""Log of motors whose thrust stops following its curve."""
AUTHORS = {
    "thrust_to_weight": 1.52,
    "motor_time_constant": 0.057,
    "latency": 0.007,
    "motor_coasting": 0.126,
    "rotor_momentum": 9.4e-5,
    "spin_down_ratio": 0.72,
}
"""The drone that flew policies, as identified (paper/notes/identification.md#real-flights)."""
MOST_S, POLICIES = 20.0, 8
"""Of a real log [s], and policies whose loops are matched."""
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


def read(log: str, folder: Path, data: Path) -> Any:
    """Returns the flights of a log, which are read or flown once."""
    from maidenflight.flights.reading import read_flights

    path, board = folder / f"{Path(log).stem}.pickle", importlib.import_module("truth_board")
    if not path.exists():
        flights = fly(log) if log in LOGS else []
        if log in MEASURED:
            file = next(iter(sorted(data.glob(board.DRONES[log].files[0]))))
            first = replace(board.DRONES[log], files=(str(file.relative_to(data)),))
            flights = board.read_drone_flights(first, data)
        elif log == SATURATED:
            flights = list(read_flights(data / log, drone="racer_5_inch"))
        path.write_bytes(pickle.dumps(flights))
    flights, used = pickle.loads(path.read_bytes()), []
    if log not in MEASURED:
        return flights
    for flight in flights:
        left = MOST_S - sum(other.duration for other in used)
        part = flight.part(0, min(len(flight), round(left / flight.period)))
        hidden = replace(part, rotor_speed=None) if board.DRONES[log].hide else part
        used += [hidden] if left > 1.0 else []
    return used


def as_numbers(estimates: Mapping[str, Any]) -> dict[str, tuple[float, ...]]:
    """Returns values and intervals by parameter."""
    return {
        name: (float(each.value), *map(float, each.interval)) for name, each in estimates.items()
    }


def identify(log: str, folder: Path, data: Path) -> Mapping[str, tuple[float, ...]]:
    """Identifies the drone of a log."""
    import maidenflight as mf

    settings = mf.Replay() if "replay" in log else mf.Likelihood()
    return as_numbers(mf.identify(read(log, folder, data), settings, key=0).estimates)


def hear(log: str, folder: Path, data: Path) -> Mapping[str, tuple[float, ...]]:
    """Returns what signals of real logs say by themselves: lags, inertia, laws of thrust."""
    from maidenflight.identification.outcome.battery_laws import law_chances
    from maidenflight.identification.signals import thrust_law
    from maidenflight.identification.signals.motor_response import estimate_motor_response
    from maidenflight.identification.signals.speed_inertia import inertia_of_speeds
    from maidenflight.identification.uncertainty import of_samples
    from maidenflight.parameters import crazyflie

    samples, results, drone = dict[str, Any](), dict[str, Any](), crazyflie()
    for name in MEASURED:
        flights, generator = read(name, folder, data), np.random.default_rng(0)
        motors = estimate_motor_response(flights, generator, drone)
        by_speeds = inertia_of_speeds(flights, drone, 500, generator)
        samples |= {f"{name}, {key} by speeds": one for key, one in by_speeds.items()}
        if motors and motors.is_identifiable:
            samples |= {f"{name}, lag": motors.lag + motors.latency}
            samples |= {f"{name}, {key}": one for key, one in motors.inertia_per_thrust.items()}
        if chances := law_chances(flights):
            thrust = sum(chance.probability * chance.thrust for chance in chances)
            results[f"{name}, thrust by laws"] = thrust, 0.95 * thrust, 1.05 * thrust
    for name in ("better_tune", SATURATED):
        flights = read(name, folder, data)
        law = thrust_law.thrust_law(flights, 0.04)
        steps = thrust_law._by_step(law.read(flights), 0.04)
        middle, curve = np.median(steps[:, 0]), thrust_law._curve(steps[steps[:, 3] <= law.limit])
        force = float(curve @ [middle, middle**2])
        results[f"{name}, force"] = force, 0.95 * force, 1.05 * force
    return results | as_numbers({each.parameter: each for each in of_samples("", samples)})


def plan(log: str, folder: Path, data: Path) -> Mapping[str, tuple[float, ...]]:
    """Plans a flight of the named Crazyflie in a small room; intervals that it expects."""
    import jax

    from maidenflight.identification.design import planning
    from maidenflight.parameters import crazyflie
    from maidenflight.simulator.realities.virtual_drone import VirtualDrone

    drone = VirtualDrone("crazyflie", crazyflie(), thrust_law=None)
    request = planning.Request((2.0, 2.0, 1.5), 40.0, rate=250, is_named=True)
    expected = planning.plan(drone, request, jax.random.key(0)).plan.expected
    return {name: (0.0, -widths.plan, widths.plan) for name, widths in expected.items()}


def match(log: str, folder: Path, data: Path) -> Mapping[str, tuple[float, ...]]:
    """Matches the closed loops of policies that the authors flew."""
    import jax

    from maidenflight.flights.reading import read_flights
    from maidenflight.identification.behaviour import flights_of_policies
    from maidenflight.identification.closed_loop import ClosedLoop
    from maidenflight.identification.closed_loop import match as match_loops
    from maidenflight.parameters import crazyflie
    from maidenflight.parameters import replace as changed

    sys.path.append(str(Path(__file__).parents[1] / "measured"))
    published, _ = importlib.import_module("predict_flights").read_published(data / "authors")
    policies = {name: one for name, one in published.items() if name.startswith("pwm/")}
    flights = read_flights(data / "authors/flights/pwm", commands="zero-order-hold").flights
    loops, key = ClosedLoop(flights=8, steps=3), jax.random.key(0)
    own = flights_of_policies(flights, policies)
    some = {name: own[name] for name in list(own)[:POLICIES]}
    start = changed(crazyflie(), **AUTHORS)
    found = match_loops(some, policies, start, key, loops, every=flights).estimates
    count = float(sum(map(len, own.values())))
    return {
        name: (value, value - 1.96 * error, value + 1.96 * error)
        for name, (value, error) in found.items()
    } | {"flights": (count, 0.9 * count, 1.1 * count)}


def repeat(log: str, folder: Path, data: Path) -> Mapping[str, tuple[float, ...]]:
    """Flies the path of a log and identifies that flight."""
    import jax

    import maidenflight as mf
    from maidenflight.identification.path_flights import fly_paths
    from maidenflight.parameters import crazyflie

    flights = read("near, state", folder, data)
    drone = crazyflie()
    again = fly_paths(drone, drone, flights, jax.random.key(1))
    assert again is not None
    return as_numbers(mf.identify(again, mf.Likelihood(), key=0).estimates)


OTHERS: Mapping[str, Callable[[str, Path, Path], Mapping[str, tuple[float, ...]]]] = {
    "plan": plan,
    "closed loop": match,
    "path flights": repeat,
    "signals": hear,
}
"""By name what is done beside identifying."""


def trial(
    log: str, factors: Mapping[str, float], watched: Sequence[str], folder: Path, data: Path
) -> None:
    """Prints results with constants changed, and which constants were used."""
    change_imports(factors, watched)
    estimates = OTHERS.get(log, identify)(log, folder, data)
    print(json.dumps({"estimates": estimates, "used": sorted(USED)}))


class Trials:
    """What has been tried, in a file of a line each."""

    def __init__(self, folder: Path, data: Path) -> None:
        """Reads what was tried before."""
        self.data, self.folder = data, folder
        self.path, self.done = folder / "trials.jsonl", dict[str, Any]()
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
            command += ["--data", str(self.data)]
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
    parser.add_argument("--logs", nargs="*", choices=[*LOGS, *MEASURED, *OTHERS], default=LOGS)
    parser.add_argument("--at-once", type=int, default=16, help="constants of a first group")
    parser.add_argument("-o", "--output", type=Path, default=Path("constants"))
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="of real logs")
    parser.add_argument("--trial", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.trial:
        log, factors, watched = json.loads(options.trial)
        trial(log, factors, watched, options.output, options.data)
        return
    every, trials, rows = candidates(options.prefix), Trials(options.output, options.data), []
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
