"""The verbs with files at both ends, as the command line and the demo run them.

Each function reads what it is given, does one stage, writes its results with a record of their making, and returns them.
"""

import dataclasses
import os
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
import polars

from maidenflight import parameters, policy, results
from maidenflight.deployment.authors_json import export_authors_json, read_policy
from maidenflight.deployment.c import export_c
from maidenflight.deployment.crazyflie import export_crazyflie
from maidenflight.deployment.onnx import export_onnx
from maidenflight.errors import InputError
from maidenflight.experiments import matrix
from maidenflight.experiments.flight_times import AS_FLOWN, FIRMWARE, predict_flight_times
from maidenflight.experiments.matrix import Cell, Matrix
from maidenflight.experiments.transfer import Transfer, transfer
from maidenflight.flights import log, recording
from maidenflight.flights.log import Flight
from maidenflight.flights.reading import MOST, Flights, read_flights
from maidenflight.flights.windows import HISTORY
from maidenflight.identification.identify import METHODS, OBJECTIVES, TRIM, Identification, identify, posterior_ensemble, trim_ensemble
from maidenflight.identification.prediction import predicted_windows, prediction_error
from maidenflight.identification.selection import Step
from maidenflight.parameters import Parameters
from maidenflight.policy import Policy
from maidenflight.reporting import run
from maidenflight.simulator import control, tasks
from maidenflight.simulator.bullet import DAMPING, Bullet
from maidenflight.simulator.control import Controller
from maidenflight.simulator.randomization import Distribution, Ensemble, randomize, relative_box, wide_box
from maidenflight.simulator.virtual_drone import KINDS, VirtualDrone, virtual_drone
from maidenflight.training import scoreboards
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.ppo import PPO
from maidenflight.training.train import Progress, Settings, recorded, train

StrPath = str | os.PathLike[str]


def reality(name: str) -> VirtualDrone:
    """A virtual drone by name.

    Args:
        name: `virtual:SEED`, or `near:SEED` and `far:SEED`, its milder and its stranger kin; `pybullet:SEED`, the first in PyBullet
            with the damping that Bullet has unless told otherwise; or a drone's TOML file, which is then simulated as finely as a
            virtual drone.

    Raises:
        InputError: none of these, or PyBullet is not installed.
    """
    kind, _, seed = name.partition(":")
    if kind in (*KINDS, "pybullet") and name != kind:
        if not seed.isdecimal():
            raise InputError(f"{name}: expected {kind}:SEED with a whole number, such as {kind}:7.")
        if kind == "pybullet":
            return dataclasses.replace(virtual_drone(int(seed)), name=f"pybullet-{int(seed)}", integrator=Bullet(DAMPING, DAMPING))
        return virtual_drone(int(seed), kind)
    return VirtualDrone(Path(name).stem, parameters.replace(parameters.read(name), time_step=0.001))


def record(drone: VirtualDrone, seed: int, folder: StrPath, truth: StrPath, count: int, duration: float, excitation: float) -> list[Path]:
    """Records flights on a virtual drone: one CSV a flight in `folder`, and the hidden parameters in `truth`."""
    settings = {"reality": drone.name, "flights": count, "duration": duration, "excitation": excitation}
    made = results.record(seed=seed, inputs=[], settings=settings)
    flown = recording.record(drone, jax.random.key(seed), count, duration, excitation)
    parameters.write(truth, drone.parameters, {"record": made})
    return [log.write(Path(folder) / f"{flight.name}.csv", flight, made) for flight in flown]


def evaluations_beside(output: StrPath) -> Path:
    """Where the evaluations of an identification go: `identification.csv` for `drone.toml`, `NAME_identification.csv` for `NAME.toml`."""
    path = Path(output)
    return path.with_name("identification.csv" if path.stem == "drone" else f"{path.stem}_identification.csv")


def identify_from(
    logs: StrPath,
    seed: int,
    output: StrPath,
    over: Sequence[str] | str | None,
    start: str,
    *,
    objective: str = OBJECTIVES[0],
    length: int = 30,
    history: int = HISTORY,
    evaluations: int = 60,
    trials: int = 2,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    method: str = METHODS[0],
    most_seconds: float = MOST,
    on_file: Callable[[int, int], None] | None = None,
    on_evaluation: Callable[[int, int], None] | None = None,
    on_step: Callable[[Step], None] | None = None,
) -> tuple[Flights, Identification]:
    """Identifies a drone from logs; writes `output` (TOML) and, to `evaluations_beside` it, every evaluation.

    Of more than `most_seconds` of flight, stretches of every flight are used.
    """
    flights = read_flights(logs, on_file, most_seconds, history)
    found = identify(
        flights,
        over,
        jax.random.key(seed),
        objective=objective,
        start=parameters.read(start),
        length=length,
        history=history,
        evaluations=evaluations,
        trials=trials,
        bounds=bounds,
        method=method,
        on_evaluation=on_evaluation,
        on_step=on_step,
    )
    settings: dict[str, Any] = {
        "start": Path(start).name,
        "over": over if isinstance(over, str) else list(over or found.estimates),
        "objective": objective,
        "history": history,
        "evaluations": evaluations,
        "trials": trials,
        "most_seconds": most_seconds,
        "bounds": {name: list(pair) for name, pair in (bounds or {}).items()},
    }
    if objective == "replay":
        settings |= {"length": length, "method": method}
    made = results.record(seed=seed, inputs=flights.paths, settings=settings)
    tables = {"identification": found.to_table(), "posterior": found.posterior_table(), "record": made}
    parameters.write(output, found.parameters, tables)
    results.write(evaluations_beside(output), found.history.write_csv(float_precision=9))
    return flights, found


_VALIDATION = (
    "# maidenflight validation 1: open-loop prediction errors, root mean squares over windows; horizon s, position m, velocity m/s,"
    " attitude rad, body_rates rad/s; _low and _high end the 95 % interval over stretches of flight"
)
_WINDOWS = (
    "# maidenflight windows 1: a few windows, as logged and as each model predicts them open loop from their first row; start s in the"
    " flight, time s, position m, velocity m/s, roll pitch yaw rad, body_rate rad/s"
)


def validate_with(
    drone: StrPath, logs: StrPath, seed: int, output: StrPath, horizons: Sequence[float], on_file: Callable[[int, int], None] | None = None
) -> tuple[Flights, polars.DataFrame, list[str]]:
    """Predicts flights with a drone and with the paper's Crazyflie; writes the errors to `output` as CSV.

    Beside it, as `NAME_windows.csv`, it writes a few windows row by row. Of more than `MOST` seconds of flight, stretches are predicted.

    Returns:
        The flights, the errors as `prediction_error` gives them, and notes for the user.
    """
    models = {Path(drone).name: parameters.read(drone), "paper's crazyflie": parameters.crazyflie()}
    flights = read_flights(logs, on_file, MOST)
    table = prediction_error(flights, models, horizons, key=jax.random.key(seed))
    drawn = predicted_windows(flights, models, max(horizons), key=jax.random.key(seed))
    inputs = [drone] if Path(drone).is_file() else []
    settings = {"drone": Path(drone).name, "horizons": list(horizons)}
    made = results.record(seed=seed, inputs=[*inputs, *flights.paths], settings=settings)
    results.write_table(output, _VALIDATION, made, table.write_csv(float_precision=9))
    beside = Path(output).with_name(f"{Path(output).stem}_windows.csv")
    results.write_table(beside, _WINDOWS, made, drawn.write_csv(float_precision=6))
    return flights, table, _not_held_out(drone, flights) if inputs else []


def _not_held_out(drone: StrPath, flights: Flights) -> list[str]:
    """Says so if a drone was identified from some of the flights, going by the record in its file."""
    used = {str(entry).rpartition("sha256:")[2] for entry in _table(drone, "record").get("inputs", [])}
    seen = sum(results.digest(path) in used for path in flights.paths)
    if seen == 0:
        return []
    return [f"{Path(drone).name} was identified from {seen} of these {len(flights.paths)} files; how well it predicts those is no test."]


POSTERIOR = "posterior"
"""Randomize over the drones that the flights of an identified drone leave possible."""

TRIMS = "trim"
"""Predict for drones whose constant torques differ as they did between the flights that the drone was identified from."""

WIDE = "wide"
"""Train over drones unlike the identified one too, with all the trims that its flights had."""

CHECKPOINT = "training.npz"
"""In the folder of policies: training that is under way; gone once they are written."""

SETTINGS: dict[str, AnalyticGradient] = {
    "pwm": AnalyticGradient(),
    "attitude_rate": AnalyticGradient(updates=1200, drones=128, horizon=32),
    "attitude": AnalyticGradient(updates=1200, drones=128, horizon=32),
}
"""What works out of the box, by control structure: a policy that acts less often looks as far ahead in fewer periods, and to tell the
starts that it can save from those that it cannot takes more drones."""


def settings_for(structure: str, task: str, method: str = "gradient", updates: int | None = None) -> Settings:
    """What works out of the box for a control structure, a task and a method, all by name; with other updates if given."""
    settings = PPO() if method == "ppo" else _by_gradient(structure, task)
    return settings if updates is None else dataclasses.replace(settings, updates=updates)


def _by_gradient(structure: str, task: str) -> AnalyticGradient:
    settings = SETTINGS[structure]
    if task == "hover":  # which fails beyond 5.2 rad/s
        return dataclasses.replace(settings, updates=2 * settings.updates, spin_margin=4.0)
    if task == "figure_eight":  # eight times as large as the circle, and faster
        return dataclasses.replace(settings, updates=3 * settings.updates)
    return settings


def randomized(drone: StrPath, randomization: float | str, controller: Controller) -> Distribution:
    """Drones to train over, simulated in steps that divide the controller's period; see `train_for`."""
    centre = control.in_fitting_steps(parameters.read(drone), controller)
    if randomization == POSTERIOR:
        return posterior_ensemble(centre, _table(drone, "posterior"), str(drone))
    if randomization == WIDE:
        known = _table(drone, "identification")
        return wide_box(centre, controller.name, [known.get(name, {}).get("spread", 0.0) for name in TRIM])
    return relative_box(centre, float(randomization))


def _table(drone: StrPath, title: str) -> dict[str, Any]:
    """A further table of a drone's TOML file; empty where it has none, or the drone is a named one."""
    return tomllib.loads(Path(drone).read_text(encoding="utf-8")).get(title, {}) if Path(drone).is_file() else {}


def train_for(
    drone: StrPath,
    seed: int,
    folder: StrPath,
    count: int,
    settings: Settings,
    randomization: float | str,
    on_progress: Callable[[Progress], None] | None = None,
    structure: str = "pwm",
    task: str = "circle",
    resume: bool = False,
    boards: Sequence[str] = (),
    history: int = 2,
    heading: float = 0.0,
) -> tuple[Policy, ...]:
    """Trains policies around a drone; writes one JSON a policy and `training.csv` with their scores.

    Args:
        drone: TOML file or name.
        seed: random seed.
        folder: where to write. Until the policies are written it holds `CHECKPOINT`.
        count: policies.
        settings: of the method.
        randomization: half width of a box about the drone; `POSTERIOR`: the drones that its flights leave possible; or `WIDE`: drones
            unlike it too.
        on_progress: called after each score.
        structure: name of a control structure in `control.CONTROLLERS`.
        task: name in `tasks.TASKS`.
        resume: go on from the checkpoint in the folder, with the same result as if training had never stopped.
        boards: where scores are shown too, names in `scoreboards.BOARDS`.
        history: H, instants that a policy sees.
        heading: price of a radian of heading, a control period; see `tasks.facing`.

    Raises:
        InputError: there is nothing to resume, or it is another training; or a board's package is not installed.
        WriteError: a file cannot be written, as on a full disk; what was reached until the last score is kept.
    """
    saved = Path(folder) / CHECKPOINT
    if resume and not saved.exists():
        raise InputError(f"{saved}: no training to resume. {_how_to_begin(Path(folder))}")
    controller = control.CONTROLLERS[structure]()
    box = randomized(drone, randomization, controller)
    rows: list[dict[str, Any]] = []

    def note(progress: Progress) -> None:
        for number in range(count):
            scores = {name: round(float(value[number]), 6) for name, value in progress.score._asdict().items()}
            rows.append({"update": progress.update, "steps": progress.steps, "policy": number + 1, **scores})
        show(progress)
        if on_progress is not None:
            on_progress(progress)

    said = {
        "task": task,
        "control": structure,
        "method": type(settings).__name__,
        "randomization": randomization,
        "policies": count,
        "history": history,
        "heading": heading or None,
        **recorded(settings),
    }
    keys = jax.random.split(jax.random.key(seed), count)
    with scoreboards.opened(boards, folder, count, {"drone": Path(drone).name, "seed": seed, **said}) as show:
        # Only now is all that was given known to make sense, and an earlier training may go.
        for left in [*([] if resume else [saved]), *results.leftovers(folder)]:
            left.unlink(missing_ok=True)
        practised = tasks.facing(tasks.TASKS[task](), heading) if heading else tasks.TASKS[task]()
        policies = train(practised, controller, box, keys, settings, note, saved, history)
    inputs = [drone] if Path(drone).is_file() else []
    made = results.record(seed=seed, inputs=inputs, settings=said if inputs else {"drone": str(drone), **said})
    for number, trained in enumerate(policies, 1):
        policy.write(Path(folder) / f"policy_{number}.json", trained, {**made, "number": number})
    results.write(Path(folder) / "training.csv", polars.DataFrame(rows).write_csv())
    saved.unlink()
    return policies


def _how_to_begin(folder: Path) -> str:
    """What to do where there is no checkpoint to go on from."""
    if (folder / "training.csv").exists():
        return "The policies there are of a training that has ended. Give --overwrite instead of --resume to train others in their place."
    begun = folder.is_dir() and set(folder.iterdir()) > set(results.leftovers(folder))
    return "Give --overwrite instead of --resume to begin one." if begun else "Leave out --resume to begin one."


WATCHED = 10.0
"""Longest flight that is shown of a policy in training [s]."""


def watched_flight(drone: StrPath, structure: str, task: str) -> Callable[[Policy], Flight]:
    """A function that lets a policy fly once, on the very drone that policies are trained around.

    Args:
        drone: TOML file or name.
        structure: name of a control structure in `control.CONTROLLERS`.
        task: name in `tasks.TASKS`.
    """
    controller, flown = control.CONTROLLERS[structure](), tasks.TASKS[task]()
    reality = VirtualDrone(Path(drone).stem, control.in_fitting_steps(parameters.read(drone), controller))
    return lambda one: transfer([one], [reality], 1, task=flown, controller=controller, duration=WATCHED).flights[0]


def flights_to_view(path: StrPath) -> Sequence[Flight]:
    """Flights of a run folder: test flights, or else those that were recorded; or of a log or a folder of logs, of any known kind.

    Raises:
        InputError: nothing there, or a log cannot be used.
    """
    flights = run.shown(run.read(Path(path))) if run.holds_flights(Path(path)) else ()
    return flights or read_flights(path).flights


def policy_files(given: Sequence[StrPath]) -> list[Path]:
    """The policy files among files and folders.

    Raises:
        InputError: a path does not exist, or a folder holds no policy.
    """
    files: list[Path] = []
    for path in map(Path, given):
        found = sorted(path.glob("*.json")) if path.is_dir() else [path]
        if not found:
            raise InputError(f"{path}: no policies (.json) in this folder. Train some: maidenflight train -o {path}.")
        files += found
    return files


def transfer_to(
    given: Sequence[StrPath],
    realities: Sequence[VirtualDrone],
    seed: int,
    folder: StrPath,
    trials: int,
    duration: float,
    task: str = "circle",
) -> Transfer:
    """Flies policies, ours or the authors', in realities; writes `flights.csv` with a row a flight, and every flight's log."""
    files = policy_files(given)
    policies = [read_policy(path) for path in files]
    names = [path.stem for path in files]
    flown = transfer(policies, realities, trials, jax.random.key(seed), task=tasks.TASKS[task](), duration=duration, names=names)
    settings = {"task": task, "realities": [drone.name for drone in realities], "trials": trials, "duration": duration}
    made = results.record(seed=seed, inputs=files, settings=settings)
    for flight in flown.flights:
        log.write(Path(folder) / f"{flight.name}.csv", flight, made)
    results.write(Path(folder) / "flights.csv", flown.table.write_csv())
    return flown


_ZERO_SHOT = (
    "# maidenflight zero-shot flights 1: simulated, a row a flight; training_rate Hz, motor_time_constant s and latency s of the policy's"
    " training, duration s, position_error m"
)
CELLS = "policies"
"""In the folder of a matrix: a folder of policies for each of its cells."""


def transfer_matrix(
    asked: Matrix, folder: StrPath, on_cell: Callable[[int, int, str], None] | None = None, anew: bool = False
) -> polars.DataFrame:
    """Trains the policies of a matrix and flies them; writes a folder of policies for each cell, and `flights.csv` with a row a flight.

    Cells whose policies are in the folder already are not trained again, so what was interrupted goes on.

    Args:
        asked: the matrix.
        folder: where to write.
        on_cell: called with (cells done, cells, what is next).
        anew: use nothing of what an earlier run wrote there.

    Returns:
        What `matrix.fly` gives.

    Raises:
        InputError: the folder holds policies of other settings or of another version; or a drone or a reality is unknown.
    """
    nominal, realities = parameters.read(asked.drone), [reality(name) for name in asked.realities]
    inputs = [asked.drone] if Path(asked.drone).is_file() else []
    settings = {name: value for name, value in dataclasses.asdict(asked).items() if name not in ("controls", "rates", "seed")}
    settings |= {"drone": Path(asked.drone).name, "training": [asked.said(cell) for cell in asked.cells]}
    inputs += [name for name in asked.realities if Path(name).is_file()]
    made, table = results.plain(results.record(seed=asked.seed, inputs=inputs, settings=settings)), Path(folder) / "flights.csv"
    if results.told(table) == made and not anew:
        return polars.read_csv(table, comment_prefix="#")
    policies: dict[Cell, Sequence[Policy]] = {}
    for done, cell in enumerate(asked.cells):
        if on_cell is not None:
            on_cell(done, len(asked.cells), f"training {cell.name}")
        policies[cell] = _policies_of(asked, cell, nominal, Path(folder) / CELLS / cell.name, anew)
    if on_cell is not None:
        on_cell(len(asked.cells), len(asked.cells), "flying")
    flights = matrix.fly(asked, policies, realities)
    results.write_table(table, _ZERO_SHOT, made, flights.write_csv())
    return flights


def _policies_of(asked: Matrix, cell: Cell, nominal: Parameters, folder: Path, anew: bool) -> Sequence[Policy]:
    """Those that the folder holds, or new ones that it holds then."""
    inputs = [asked.drone] if Path(asked.drone).is_file() else []
    made = results.record(seed=asked.seed, inputs=inputs, settings=asked.said(cell))
    return policy.kept(folder, asked.policies, made, lambda: matrix.train_cell(asked, cell, nominal), anew)


_PREDICTION = "# maidenflight prediction 1: simulated flights of given policies as the authors' drone ran them, a row a flight; duration s"
POSSIBLE = 256
"""Drones drawn from a box, of which each predicted flight flies one."""


def predict_with(
    drone: StrPath,
    given: Sequence[StrPath],
    seed: int,
    output: StrPath,
    *,
    trials: int,
    duration: float,
    randomization: float | str | None = None,
    structure: str | None = None,
    firmware: str = FIRMWARE,
    on_policy: Callable[[int, int], None] | None = None,
) -> tuple[list[Path], polars.DataFrame]:
    """Predicts how long policies, ours and the authors', would fly on the real drone; writes `output`, a CSV with a row a flight.

    Args:
        drone: TOML file or name.
        given: policy files, and folders of them.
        seed: random seed.
        output: CSV file.
        trials: flights of each policy.
        duration: longest flight [s].
        randomization: half width of a box about the drone; `POSTERIOR`: each flight is another of the drones that its flights leave
            possible; `TRIMS`: constant torques differ between flights as they did in those; `TRIMS` where the drone's file tells how they
            differ, unless given.
        structure: what the authors' policies command; what their files' names say unless given.
        firmware: what the drone runs: that of the authors' drone, or another, for which policies of ours are trained.
        on_policy: called with (policies flown, policies).

    Returns:
        The policy files, and what `predict_flight_times` gives, policies in the order of the files.

    Raises:
        InputError: a file is no policy, or the drone has no posterior.
    """
    randomization = usual_randomization(drone) if randomization is None else randomization
    drones = possible_drones(drone, randomization, seed)
    files = list(dict.fromkeys(policy_files(given)))
    policies = [read_policy(path, structure) for path in files]
    flown = predict_flight_times(
        policies,
        drones,
        jax.random.key(seed),
        trials=trials,
        duration=duration,
        structures=AS_FLOWN if firmware == FIRMWARE else control.CONTROLLERS,
        names=_names(files),
        on_policy=on_policy,
    )
    inputs = [drone, *files] if Path(drone).is_file() else files
    settings = {"drone": Path(drone).name, "trials": trials, "duration": duration, "randomization": randomization, "control": structure}
    settings |= {"firmware": firmware}
    made = results.record(seed=seed, inputs=inputs, settings=settings)
    results.write_table(output, _PREDICTION, made, flown.write_csv(float_precision=2))
    return files, flown


def usual_randomization(drone: StrPath) -> float | str:
    """What predictions are randomized over where nobody says."""
    told = _table(drone, "identification")
    return TRIMS if any("spread" in told.get(name, {}) for name in TRIM) else 0.0


def possible_drones(drone: StrPath, randomization: float | str, seed: int) -> Parameters:
    """What `randomization` makes of a drone, as `predict_with` understands it: a point, or drones stacked along a first axis."""
    if not randomization:
        return parameters.read(drone)
    if randomization == TRIMS:
        return trim_ensemble(parameters.read(drone), _table(drone, "identification"), str(drone)).drones
    distribution = randomized(drone, randomization, control.pwm())
    if isinstance(distribution, Ensemble):
        return distribution.drones
    keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), 1), POSSIBLE)
    return jax.tree.map(np.asarray, jax.vmap(lambda key: randomize(distribution, key))(keys))


def _names(files: Sequence[Path]) -> list[str]:
    """Files without their ending, each with as many of its folders as tell all of them apart."""
    parts = [path.absolute().with_suffix("").parts for path in files]
    for depth in range(1, max(map(len, parts)) + 1):
        names = ["/".join(part[-depth:]) for part in parts]
        if len(set(names)) == len(names):
            return names
    return [str(path) for path in files]


def best_policy(flown: Transfer, files: Sequence[Path]) -> Path:
    """The policy that flew longest and, among equals, closest."""
    order = flown.table.group_by("policy").agg(polars.col("duration").mean(), polars.col("position_error").mean())
    name = order.sort(["duration", "position_error", "policy"], descending=[True, False, False])["policy"][0]
    return next(path for path in files if path.stem == name)


def export(path: StrPath, folder: StrPath, seed: int, to: str = "c", structure: str | None = None) -> list[Path]:
    """Writes a policy, ours or the authors', for other programs.

    Args:
        path: policy file.
        folder: where to write; made if missing.
        seed: draws the observations of the C code's self-test.
        to: `c`: C99, `policy.h` and `policy.c`; `onnx`: `policy.onnx`; `authors`: a JSON as the authors' tools read it;
            `crazyflie`: an app for the Crazyflie's firmware.
        structure: what an authors' policy commands; what its file's name says unless given.

    Returns:
        The files written.

    Raises:
        InputError: the file is no policy, or what is written cannot hold it.
    """
    read = read_policy(path, structure)
    settings = {"control": structure}
    if to == "authors":
        return [export_authors_json(read, folder, name=Path(path).stem)]
    if to == "onnx":
        return [export_onnx(read, folder, record=results.record(seed=None, inputs=[path], settings=settings))]
    if to == "crazyflie":
        return export_crazyflie(read, folder, seed=seed, record=results.record(seed=seed, inputs=[path], settings=settings))
    return export_c(read, folder, seed=seed, record=results.record(seed=seed, inputs=[path], settings=settings))
