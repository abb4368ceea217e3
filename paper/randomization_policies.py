"""What the study of randomizations trains: policies of each structure and randomization."""

from dataclasses import replace as replaced
from pathlib import Path
from typing import NamedTuple

import jax
from kept_policies import kept_policies
from randomization_shares import COLOURS

from maidenflight import results
from maidenflight.experiments.drones import distribution_of
from maidenflight.names import POSTERIOR, WIDE
from maidenflight.policy import Policy
from maidenflight.simulator.controllers import control
from maidenflight.simulator.tasks import tasks
from maidenflight.simulator.tasks.tasks import Task
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.settings import recorded
from maidenflight.training.train import train

BOX = 0.10
"""Half width of the paper's box."""


class Cell(NamedTuple):
    """What some policies are trained for."""

    control: str
    randomization: str

    @property
    def name(self) -> str:
        """Of the folder of its policies."""
        return f"{self.control}_{self.randomization}"


QUICK = {
    "pwm": AnalyticGradient(updates=800, hidden_learning_rate=0.0, action_change_penalty=0.0),
    "attitude_rate": AnalyticGradient(
        updates=600, horizon=32, hidden_learning_rate=0.0, action_change_penalty=0.0
    ),
    "attitude": AnalyticGradient(
        updates=600, horizon=32, hidden_learning_rate=0.0, action_change_penalty=0.0
    ),
}
"""Settings of training, by control structure: half as long as the command line's, or less, and by
Adam alone, as paper/notes/randomization.md was measured."""
RECIPE = {
    kind: replaced(settings, updates=settings.updates * 2) for kind, settings in QUICK.items()
}
"""Those of the recipe: drones that differ more take longer to learn."""
CELLS = [Cell(kind, randomization) for kind in QUICK for randomization in COLOURS]

YAW_PENALTY = 0.1
"""What the recipe's task takes for a radian of heading, a control period."""


def choose_task(randomization: str) -> Task:
    """The paper's circle; for the recipe with a price on turning away."""
    return (
        tasks.with_yaw_penalty(tasks.paper_circle(), YAW_PENALTY)
        if randomization == "recipe"
        else tasks.paper_circle()
    )


def choose_settings(cell: Cell, updates: int | None) -> AnalyticGradient:
    """Settings of training, with other updates if given."""
    settings = (RECIPE if cell.randomization == "recipe" else QUICK)[cell.control]
    return replaced(settings, updates=updates or settings.updates)


RANDOMIZATIONS = {"none": 0.0, "box": BOX, "posterior": POSTERIOR, "recipe": WIDE}
"""As `maidenflight train --randomize` takes them."""


def train_cell(
    cell: Cell, drone: str, settings: AnalyticGradient, seeds: int, seed: int, folder: Path
) -> list[Policy]:
    """Policies of a cell: those that the folder holds, or new ones that it holds then.

    Raises:
        InputError: the folder holds policies of other settings, or the drone's file does not tell
            what the cell asks for.
    """
    controller = control.CONTROLLERS[cell.control]()
    drones = distribution_of(drone, RANDOMIZATIONS[cell.randomization], controller)
    priced = {"yaw_penalty": YAW_PENALTY} if cell.randomization == "recipe" else {}
    run_settings = {
        **cell._asdict(),
        "drones": str(drones),
        **priced,
        "policies": seeds,
        **recorded(settings),
    }
    record = results.record(seed=seed, inputs=[drone], settings=run_settings)
    # What a cell's policies are depends neither on the other cells nor on what an interrupted run
    # left.
    keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), CELLS.index(cell)), seeds)
    return kept_policies(
        folder / cell.name,
        seeds,
        record,
        lambda: train(choose_task(cell.randomization), controller, drones, keys, settings),
    )
