"""Flights of policies from files: in unseen realities, as a matrix, and as on the real drone."""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import jax
import polars

from maidenflight import manifest, policy_file, results, run_folder
from maidenflight.deployment.authors_json import read_policy
from maidenflight.experiments import matrix
from maidenflight.experiments.as_flown import FIRMWARE, controller_as_flown
from maidenflight.experiments.flight_times import predict_flight_times
from maidenflight.experiments.matrix import Cell, Matrix, Row
from maidenflight.experiments.transfer import LIMIT_CYCLE, Transfer, transfer
from maidenflight.flights import log
from maidenflight.flights.log import Flight
from maidenflight.flights.reading import read_flights
from maidenflight.identification.drone_file import DroneFile
from maidenflight.inputs import StrPath
from maidenflight.policy import Policy
from maidenflight.reporting import run
from maidenflight.simulator import control, tasks
from maidenflight.simulator.reality import AnyReality
from maidenflight.workflow.drones import (
    drone_to_fly,
    possible_drones,
    reality,
    usual_randomization,
)
from maidenflight.workflow.policies import names, own_and_foreign, policy_files, read_as


def transfer_to(
    given: Sequence[StrPath],
    realities: Sequence[AnyReality],
    seed: int,
    folder: StrPath,
    trials: int,
    duration: float,
    task: str = "circle",
) -> Transfer:
    """Flies policies, ours, the authors' or by others, in realities.

    Writes `flights.csv` with a row a flight, and every flight's log.
    """
    own, others = own_and_foreign(given)
    files = policy_files(own)
    policies = [read_policy(path) for path in files]
    flown = transfer(
        [*policies, *others],
        realities,
        trials,
        jax.random.key(seed),
        task=tasks.TASKS[task](),
        duration=duration,
        names=[*names(files), *(one.name for one in others)],
    )
    settings = {
        **({"foreign": [one.name for one in others]} if others else {}),
        "task": task,
        "realities": [drone.name for drone in realities],
        "trials": trials,
        "duration": duration,
    }
    described = [path for path in given if Path(path).suffix in (".toml", ".zip")]
    made = results.record(seed=seed, inputs=[*files, *described], settings=settings)
    written = [
        log.write(Path(folder) / f"{flight.name}.csv", flight, made) for flight in flown.flights
    ]
    results.remove_older(written, made)
    table = run_folder.FLIGHTS.write(Path(folder, run_folder.FLIGHTS.name), flown.table)
    wrote: manifest.Files = {"flights": [table], "flight_logs": written}
    manifest.append(folder, "transfer", wrote, made, {"policies": [*files, *described]})
    return flown


def transfer_matrix(
    asked: Matrix,
    folder: StrPath,
    on_row: Callable[[int, int, str], None] | None = None,
    restart: bool = False,
    accept_bounds: bool = False,
) -> polars.DataFrame:
    """Trains the policies of a matrix and flies them.

    Writes a folder of policies for each cell, and `flights.csv` with a row a flight.

    Rows whose policies are in the folder already are not trained again, so what was interrupted
    goes on.

    Args:
        asked: the matrix.
        folder: where to write.
        on_row: called with (rows done, rows, what is next).
        restart: use nothing of what an earlier run wrote there.
        accept_bounds: see `drone_to_fly`.

    Returns:
        What `matrix.fly` gives.

    Raises:
        InputError: the folder holds policies of other settings or of another version; or a drone or
            a reality is unknown.
    """
    drone = drone_to_fly(asked.drone, accept_bounds)
    realities = [reality(name, accept_bounds) for name in asked.realities]
    inputs = [asked.drone] if Path(asked.drone).is_file() else []
    settings = {
        name: value
        for name, value in dataclasses.asdict(asked).items()
        if name not in ("controls", "rates", "seed")
    }
    settings |= {
        "drone": Path(asked.drone).name,
        "training": [asked.said(cell) for cell in asked.cells],
    }
    inputs += [name for name in asked.realities if Path(name).is_file()]
    made, table = (
        results.plain(results.record(seed=asked.seed, inputs=inputs, settings=settings)),
        Path(folder, run_folder.MATRIX_FLIGHTS.name),
    )
    if results.read_record(table) == made and not restart:
        return polars.read_csv(table, comment_prefix="#")
    policies: dict[Cell, Sequence[Policy]] = {}
    for done, row in enumerate(asked.rows):
        if on_row is not None:
            on_row(done, len(asked.rows), f"training {row.name}")
        policies |= _policies_of(asked, row, drone, Path(folder, run_folder.POLICIES), restart)
    if on_row is not None:
        on_row(len(asked.rows), len(asked.rows), "flying")
    flights = matrix.fly(asked, policies, realities)
    run_folder.MATRIX_FLIGHTS.write(table, flights, made)
    cells = (Path(folder, run_folder.POLICIES, cell.name) for cell in policies)
    written = [path for cell in cells for path in run_folder.POLICY.find(cell)]
    manifest.append(
        folder, "transfer", {"flights": [table], "policies": written}, made, {"drone": inputs}
    )
    return flights


def matrix_row(
    asked: Matrix, row: Row, folder: StrPath, accept_bounds: bool = False
) -> dict[Cell, Sequence[Policy]]:
    """Trains the policies of one row of a matrix, as `transfer_matrix` does.

    Writes them to the folder, those of each cell to one named after it.

    Raises:
        InputError: the drone is unknown, or see `drone_to_fly`.
    """
    drone = drone_to_fly(asked.drone, accept_bounds)
    return _policies_of(asked, row, drone, Path(folder), restart=False)


def _policies_of(
    asked: Matrix, row: Row, drone: DroneFile, folder: Path, restart: bool
) -> dict[Cell, Sequence[Policy]]:
    """Those that the folder holds, or new ones that it holds then."""
    inputs = [asked.drone] if Path(asked.drone).is_file() else []

    @functools.cache
    def learned() -> Mapping[Cell, Sequence[Policy]]:
        return matrix.train_cells(asked, row.cells, drone.parameters, drone.full_scale_counts)

    return {
        cell: policy_file.kept(
            Path(folder, cell.name),
            asked.policies,
            results.record(seed=asked.seed, inputs=inputs, settings=asked.said(cell)),
            lambda cell=cell: learned()[cell],
            restart,
        )
        for cell in row.cells
    }


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
    accept_bounds: bool = False,
    on_policy: Callable[[int, int], None] | None = None,
    today: StrPath | None = None,
) -> tuple[list[Path], polars.DataFrame]:
    """Predicts how long policies, ours and the authors', would fly on the real drone.

    Writes `output`, a CSV with a row a flight.

    Args:
        drone: TOML file or name.
        given: policy files, and folders of them.
        seed: random seed.
        output: CSV file.
        trials: flights of each policy.
        duration: longest flight [s].
        randomization: half width of a box about the drone; `POSTERIOR`: each flight is of
            another posterior sample; `TRIMS`: constant torques differ between flights as between
            those that the drone was identified from. Unless given, `TRIMS` where the drone's file
            says how they differ.
        structure: what the authors' policies command; what their files' names say unless given.
        firmware: what the drone runs: that of the authors' drone, or another, for which policies of
            ours are trained.
        accept_bounds: see `drone_to_fly`.
        on_policy: called with (policies flown, policies).
        today: a log or a folder of flights of the day, by any controller, which tell trims and
            thrust of today.

    Returns:
        The policy files, and what `predict_flight_times` gives, policies in the order of the files.

    Raises:
        InputError: a file is no policy, or one of ours of another structure; or the drone has no
            posterior, or is refused.
    """
    drone_to_fly(drone, accept_bounds)
    randomization = usual_randomization(drone) if randomization is None else randomization
    drones = possible_drones(drone, randomization, seed, today)
    files = policy_files(given)
    policies = [read_as(path, structure) for path in files]
    flown = predict_flight_times(
        policies,
        drones,
        jax.random.key(seed),
        trials=trials,
        duration=duration,
        controller_for=controller_as_flown
        if firmware == FIRMWARE
        else partial(control.controller_for, firmware=firmware),
        names=names(files),
        on_policy=on_policy,
    )
    inputs = [drone, *files] if Path(drone).is_file() else files
    settings = {
        "drone": Path(drone).name,
        "trials": trials,
        "duration": duration,
        "randomization": randomization,
        "control": structure,
    }
    settings |= {"firmware": firmware, "today": None if today is None else Path(today).name}
    made = results.record(seed=seed, inputs=inputs, settings=settings)
    run_folder.PREDICTION.write(output, flown, made)
    read: manifest.Files = {"drone": inputs[: -len(files)], "policies": files}
    manifest.append(output, "predict", {"prediction": [output]}, made, read)
    return files, flown


def best_policy(flown: Transfer, files: Sequence[Path]) -> Path:
    """The policy that flew longest and, among equals, closest; one in a limit cycle only for want.

    Of what `transfer_to` gives, and the files of ours that it flew.
    """
    own = flown.table.filter(polars.col("policy").is_in(names(files)))
    order = own.group_by("policy").agg(
        polars.col("duration").mean(),
        polars.col("position_error").mean(),
        (polars.col("command_change").mean() > LIMIT_CYCLE).alias("limit_cycle"),
    )
    keys = ["duration", "limit_cycle", "position_error", "policy"]
    name = order.sort(keys, descending=[True, False, False, False])["policy"][0]
    return next(path for path, called in zip(files, names(files), strict=True) if called == name)


def transfer_summary(flown: Transfer) -> polars.DataFrame:
    """Flights, those that reached the time limit, and mean duration [s] and error [m].

    A row a policy and reality.
    """
    return flown.table.group_by("policy", "reality", maintain_order=True).agg(
        polars.len().alias("flights"),
        (polars.col("end_reason") == "time limit").sum().alias("time_limit"),
        polars.col("duration").mean(),
        polars.col("position_error").mean(),
        polars.col("command_change").mean(),
        polars.col("at_limits").mean(),
    )


def limit_cycles(summary: polars.DataFrame) -> list[str]:
    """A sentence on each policy and reality whose motors are thrown between their limits.

    Of what `transfer_summary` gives.
    """
    return [
        f"{row['policy']} in {row['reality']} changes its commands by {row['command_change']:.2f} "
        f"of full thrust in 10 ms, {100 * row['at_limits']:.0f} % of them at a limit: a limit "
        "cycle, which wears motors and seldom survives on a real drone. Identify the drone from "
        "its flights, or train with its latency."
        for row in summary.iter_rows(named=True)
        if row["command_change"] > LIMIT_CYCLE
    ]


def flights_to_view(path: StrPath) -> Sequence[Flight]:
    """Flights of a run, or of what its manifest lists: test flights, else recorded ones.

    Or of a log or a folder of logs, of any known kind.

    Raises:
        InputError: nothing there, or a log cannot be used.
    """
    place = Path(path)
    listed = manifest.find_manifest(place) is not None
    return (run.shown(run.read(place)) if listed else ()) or read_flights(place).flights
