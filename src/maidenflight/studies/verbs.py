"""The kinds of task of maidenflight: each calls a verb of `workflow`, and returns what it found."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import polars

from maidenflight import cores, parameters, run_folder, workflow
from maidenflight.errors import InputError
from maidenflight.experiments.envelope import summary as envelope_summary
from maidenflight.experiments.flight_times import summary as times_summary
from maidenflight.identification.likelihood import Likelihood
from maidenflight.simulator.reality import AnyReality
from maidenflight.studies.kinds import Row, Work
from maidenflight.training.train import Progress


def identify(work: Work) -> list[Row]:
    """Identifies a drone; a row a parameter, with its value and 95 % interval [SI]."""
    given = work.settings
    mass = given["mass"]
    _, found = workflow.identify_from(
        given["logs"],
        given["seed"],
        work.folder / run_folder.DRONE,
        Likelihood(evaluations=given["evaluations"], trials=given["trials"]),
        start=workflow.Start(given["start"], None if mass is None else mass / 1e3),
        over=given["over"],
        reading=workflow.Reading(given["most_seconds"]),
    )
    return [
        {
            "parameter": name,
            "value": float(one.value),
            "low": float(one.interval[0]),
            "high": float(one.interval[1]),
        }
        for name, one in found.estimates.items()
    ]


def train(work: Work) -> list[Row]:
    """Trains policies together; a row a policy, with its best scores."""
    cores.as_devices(work.cpus)
    given = work.settings
    control, task, count = given["control"], given["task"], given["policies"]
    hidden = None if given["hidden"] is None else tuple(given["hidden"])
    settings = workflow.settings_for(
        control, task, given["method"], given["updates"], hidden, given["memory"]
    )
    randomize = given["randomize"]
    folder = work.folder / run_folder.POLICIES
    heard: list[Progress] = []
    workflow.train_for(
        given["drone"],
        given["seed"],
        folder,
        count,
        settings,
        workflow.usual_training_box(task, control) if randomize is None else randomize,
        heard.append,
        control,
        task,
        history=given["history"],
        yaw_penalty=given["yaw_penalty"],
        accept_bounds=given["accept_bounds"],
        memory=given["memory"],
    )
    # The study is resumed by tasks, and the state of a training is larger than its policies.
    (folder / run_folder.CHECKPOINT).unlink(missing_ok=True)
    return [
        {"policy": f"policy_{number}", **scores}
        for number, scores in enumerate(workflow.best_scores(heard, count), 1)
    ]


def transfer(work: Work) -> list[Row]:
    """Flies policies in realities; a row a policy and reality."""
    given = work.settings
    _, task = _flown(given)
    flown = workflow.transfer_to(
        _policies(given),
        _places(given),
        given["seed"],
        work.folder / run_folder.TRANSFER,
        given["trials"],
        given["duration"],
        given["task"] or task,
    )
    return workflow.transfer_summary(flown).to_dicts()


def predict(work: Work) -> list[Row]:
    """Predicts flight times on a drone; a row a policy, with quantiles [s]."""
    cores.as_devices(work.cpus)
    given = work.settings
    _, flown = workflow.predict_with(
        given["drone"],
        _policies(given),
        given["seed"],
        work.folder / run_folder.PREDICTION.name,
        trials=given["trials"],
        duration=given["duration"],
        randomization=given["randomize"],
        structure=given["control"],
        firmware=given["firmware"],
        accept_bounds=given["accept_bounds"],
    )
    return times_summary(flown).to_dicts()


def envelope(work: Work) -> list[Row]:
    """How hard flights may be before policies do not fly them; a row a policy, reality and axis."""
    given = work.settings
    _, task = _flown(given)
    flown = workflow.envelope_of(
        _policies(given),
        _places(given),
        given["along"],
        given["seed"],
        work.folder / "envelope",
        flights=given["flights"],
        task=task,
    )
    return envelope_summary(flown).select(polars.exclude(polars.List)).to_dicts()


def _policies(given: Mapping[str, Any]) -> list[str]:
    """Files and folders; what another task made is one folder."""
    policies = given["policies"]
    return [policies] if isinstance(policies, str) else list(policies)


def _flown(given: Mapping[str, Any]) -> tuple[list[Path], str]:
    files = workflow.policy_files(workflow.own_and_foreign(_policies(given))[0])
    return files, workflow.task_to_fly(files, None)[0]


def _places(given: Mapping[str, Any]) -> list[AnyReality]:
    asked = given["realities"] or [f"virtual:7@{given['drone']}" if given["drone"] else "virtual:7"]
    return [workflow.reality(name, given["accept_bounds"]) for name in asked]


def check_identify(given: Mapping[str, Any]) -> None:
    """Refuses a start that is no drone, and unknown parameters."""
    parameters.read(given["start"])
    over = given["over"]
    for name in over if isinstance(over, list) else ():
        if name not in parameters.COMPONENTS:
            raise InputError(
                f"over names {name!r}, which is no parameter. All are in what this prints: "
                "maidenflight drone crazyflie."
            )


def check_train(given: Mapping[str, Any]) -> None:
    """Refuses what is no drone."""
    if "drone" in given:
        workflow.drone_to_fly(given["drone"], given["accept_bounds"])


def check_flights(given: Mapping[str, Any]) -> None:
    """Refuses what is no drone, no reality or no policy."""
    if given.get("drone") is not None:
        workflow.drone_to_fly(given["drone"], given["accept_bounds"])
    for name in given.get("realities") or ():
        workflow.reality(name, given["accept_bounds"])
    if "policies" in given:
        _flown(given)
