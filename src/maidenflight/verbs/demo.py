"""`Demo`: the full pipeline on a virtual drone, by the verbs."""

import dataclasses
import time
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

from maidenflight import manifest, run_folder
from maidenflight.inputs import StrPath
from maidenflight.terminal import Table
from maidenflight.verb import Output, Progress, Result, Verb
from maidenflight.verbs import shared
from maidenflight.verbs.export import Export
from maidenflight.verbs.identify import Identify
from maidenflight.verbs.record import Record
from maidenflight.verbs.report import Report
from maidenflight.verbs.train import Train
from maidenflight.verbs.transfer import Transfer, tabulate_flights

if TYPE_CHECKING:
    from polars import DataFrame

DRONE = "crazyflie"
"""Named drone that training is compiled with."""


@dataclass(frozen=True)
class Stages:
    """The verbs of a demo, but for their inputs and seeds."""

    record: Record = Record()
    identify: Identify = Identify(logs=Path("."), trials=1)
    train: Train = Train(
        randomize=0.1,  # as the paper's
        accept_bounds=True,
        updates=600,
        learner={"evaluations": 6},
    )
    transfer: Transfer = Transfer(policies=(".",), accept_bounds=True, against=())


class Demo(Verb):
    """Run the full pipeline on a virtual drone, in minutes.

    It records flights, identifies the drone from them, trains policies, flies them unseen, exports
    the best one and writes a report.
    """

    output = Output(None, "Folder; the first free of run, run-2, ... by default.")
    fused, parallel, steady, in_studies = True, True, False, False

    seed: int = shared.seed(7)

    def choose_output(self, output: StrPath | None) -> Path:
        """Returns the folder; the first that is free by default."""
        if output is not None:
            return Path(output)
        names = (Path("run" if number == 1 else f"run-{number}") for number in range(1, 10**6))
        return next(path for path in names if not path.exists())

    def compute(self, output: Path, progress: Progress, stages: Stages = Stages()) -> Result:
        """Runs every stage on the virtual drone of the seed.

        Identification and training see only the recorded flights; the truth is read again only for
        the summary.
        """
        from maidenflight.identification.truth import read_truth
        from maidenflight.verbs.parts import estimates_output

        reality = f"virtual:{self.seed}"
        Thread(target=_compile_ahead, args=(stages, reality), daemon=True).start()
        seconds: dict[str, float] = {}
        stage_results: dict[str, Result] = {}

        def run(verb: Verb, part: str, summary: str) -> None:
            progress.log(f"{verb.name:<9} {summary}", always=True)
            progress.move(0, None, f"{verb.name}: compiling and running")
            began = time.perf_counter()
            stage_results[verb.name] = verb.run(output / part, _Stage(progress, verb.name))
            seconds[verb.name] = round(time.perf_counter() - began, 2)

        def configure(verb: Any, **settings: Any) -> Any:
            return dataclasses.replace(verb, seed=self.seed, **settings)

        recorded, drone = run_folder.RECORDED[0], output / run_folder.DRONE
        record = configure(stages.record, reality=reality)
        flights = f"{record.flights or 4} flights of {record.duration:g} s"
        run(record, recorded, f"{flights} on a virtual drone (simulated), by the firmware's PID")
        identify = configure(stages.identify, logs=output / recorded)
        aim = "motors, delays and whatever else these flights determine"
        run(identify, run_folder.DRONE, aim)
        train = configure(stages.train, drone=str(drone))
        aim = f"{train.policies} policies by gradients through the simulator"
        run(train, run_folder.POLICIES, aim)
        policies = (str(output / run_folder.POLICIES),)
        transfer = configure(stages.transfer, policies=policies, reality=(reality,))
        flights = f"{train.policies * transfer.trials} zero-shot flights"
        run(
            transfer, run_folder.TRANSFER, f"{flights} in the virtual reality they did not train on"
        )
        best = Path(stage_results[transfer.name].content["best"])
        run(configure(Export(policy=best)), run_folder.FIRMWARE, "the best policy to C99")
        stage_file = run_folder.write_stages(output, self.seed, seconds)
        manifest.append(stage_file, self.name, {"stages": [stage_file]}, self.make_record())
        run(Report(runs=(output,)), run_folder.REPORT, "one page to look at")
        identified, evaluation = stage_results["identify"].value, stage_results["transfer"]
        times = ", ".join(f"{name} {spent:.0f} s" for name, spent in seconds.items())
        truth = read_truth(output / recorded / run_folder.REALITY, identified.estimates)
        return Result(
            content={
                "parameters": {
                    name: {"value": estimate.value, "interval": list(estimate.interval)}
                    for name, estimate in identified.estimates.items()
                },
                "truth": truth,
                "notes": identified.notes,
                "flights": evaluation.content["flights"],
                "stages": seconds,
                "best": str(best),
                "report": str(output / run_folder.REPORT),
                "simulated": True,
            },
            summary=[
                *estimates_output.tabulate_estimates(identified, truth),
                *estimates_output.summarize(identified),
                *_summarize_flights(evaluation.value.table),
                f"wall time: {times}",
                *_list_files(output, best),
            ],
            notes=identified.notes,
            value=stage_results,
        )


class _Stage(Progress):
    """Shows how far a stage is on the bar of the demo."""

    def __init__(self, progress: Progress, name: str) -> None:
        self._progress, self._name = progress, name

    def move(self, done: int, total: int | None, remark: str = "") -> None:
        """Moves the bar."""
        self._progress.move(done, total, f"{self._name}: {remark}")

    def log(self, line: str, always: bool = False) -> None:
        """Passes a line on."""
        self._progress.log(line, always)


def _compile_ahead(stages: Stages, reality: str) -> None:
    """Compiles training, by an update for any drone, and flights, while others are recorded."""
    from jax.random import split as split_key

    from maidenflight.experiments import drones
    from maidenflight.experiments.transfer import transfer
    from maidenflight.simulator.controllers import control
    from maidenflight.simulator.tasks.tasks import find_task
    from maidenflight.training.final_flights import fly_about
    from maidenflight.training.train import train

    controller, learner = control.pwm(), stages.train.learner_settings
    task, file = find_task("circle"), drones.read_drone(DRONE)
    policies = train(
        task,
        controller,
        drones.distribution_of(file, stages.train.randomize or 0.0, controller),
        split_key(stages.train.key, stages.train.policies),
        dataclasses.replace(learner, updates=1, evaluations=1),  # type: ignore[call-arg]
        policy=stages.train.spec,
    )
    about = DRONE, file.parameters, file.full_scale_counts
    fly_about(*about, task, controller, stages.train.key, policies)
    drone = drones.find_reality(reality, stages.transfer.accept_bounds)
    transfer(policies, drone, stages.transfer.trials, duration=stages.transfer.duration)


def _summarize_flights(table: "DataFrame") -> list[Table | str]:
    """Returns the zero-shot flights, each and all."""
    reached = table.filter(table["end_reason"] == "time limit").height
    error = float(table["position_error"].to_numpy().mean())
    return [
        "Intervals show how much values depend on these flights, not on the model: the truth may "
        "lie outside where this drone has\nwhat the model lacks, such as late sensors and a "
        "battery that sags.",
        tabulate_flights(table.to_dicts()),
        f"{reached} of {table.height} flights reached the time limit; median "
        f"{table['duration'].median():.1f} s, mean position error {error * 100:.1f} cm. Flights "
        "and drone are simulated.",
    ]


def _list_files(folder: Path, best: Path) -> list[str]:
    return [
        "",
        f"  drone      {folder / run_folder.DRONE}",
        f"  policies   {folder / run_folder.POLICIES}/",
        f"  flights    {folder / run_folder.TRANSFER}/",
        f"  C code     {folder / run_folder.FIRMWARE}/    <- of the best policy, {best.stem}",
        f"  report     {folder / run_folder.REPORT}    <- open this in a browser",
    ]
