"""The rows of a matrix as tasks of a study, so that many machines train them."""

from collections.abc import Callable
from pathlib import Path

from maidenflight import results, run_folder
from maidenflight.errors import InputError
from maidenflight.experiments import matrix_file
from maidenflight.experiments.matrix import Matrix
from maidenflight.inputs import StrPath
from maidenflight.studies import store as stores
from maidenflight.studies import sweeping
from maidenflight.studies.engine import Engine, Resources
from maidenflight.studies.kinds import Kind, Row, Work, flag, text
from maidenflight.studies.status import Progress
from maidenflight.studies.study import of

STORE = "rows"
"""In the folder of a matrix: the study of its rows."""


def _train(work: Work) -> list[Row]:
    from maidenflight import cores, workflow

    cores.as_devices(work.cpus)
    asked = matrix_file.read(work.settings["matrix"])
    (row,) = (row for row in asked.rows if row.name == work.settings["row"])
    made = workflow.matrix_row(asked, row, work.folder, work.settings["accept_bounds"])
    return [{"policies": sum(map(len, made.values()))}]


row = Kind(
    _train,
    {
        "matrix": text("settings of a matrix", files=True),
        "drone": text("a drone's name or TOML file", files=True),
        "row": text("a row's name"),
        "accept_bounds": flag(),
    },
)
"""Trains the policies of one row."""


def forget(folder: StrPath) -> None:
    """Removes the policies and rows of an earlier run from the folder of a matrix."""
    for path in Path(folder, run_folder.POLICIES).glob(f"*/{run_folder.POLICY.stem}_*"):
        path.unlink()
    store = stores.opened(Path(folder, STORE))
    for key in sorted(store.keys()):
        store.remove(key)


def train_rows(
    settings: StrPath,
    asked: Matrix,
    folder: StrPath,
    on: str | Engine,
    resources: Resources | None = None,
    *,
    accept_bounds: bool = False,
    on_progress: Callable[[Progress], None] | None = None,
) -> None:
    """Trains the rows of a matrix whose policies its folder does not hold yet.

    Args:
        settings: file of the matrix, at a path that all machines have.
        asked: what it says.
        folder: of the matrix, which all machines share; policies go where `transfer_matrix` looks.
        on: see `sweeping.sweep`.
        resources: what the engine may use.
        accept_bounds: see `workflow.drone_to_fly`.
        on_progress: see `sweeping.sweep`.

    Raises:
        InputError: see `sweeping.sweep`.
    """
    policies = Path(folder, run_folder.POLICIES)
    left = [
        one.name
        for one in asked.rows
        if any(
            len(run_folder.POLICY.find(policies / cell.name)) < asked.policies for cell in one.cells
        )
    ]
    if not left:
        return
    entry = {
        "name": "row",
        "kind": "maidenflight.studies.rows:row",
        "settings": {
            "matrix": str(settings),
            "drone": asked.drone,
            "accept_bounds": accept_bounds,
        },
        "grid": {"row": left},
    }
    study = of([entry], where=str(settings))
    store = stores.opened(Path(folder, STORE))
    failures = sweeping.compute(study, store, on, resources or Resources(), 1, on_progress)
    for task in study.tasks:
        if task.key not in failures:
            made = store.folder(task.key)
            for path in made.glob(f"*/{run_folder.POLICY.stem}_*"):
                results.write(policies / path.relative_to(made), path.read_bytes())
    if failures:
        raise InputError(sweeping.told(study, failures, store.address))
