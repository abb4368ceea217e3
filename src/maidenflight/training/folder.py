"""The folder of a training: its policies, their scores, and a checkpoint to resume from."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from maidenflight import manifest, parameters, policy_file, results, run_folder
from maidenflight.errors import InputError
from maidenflight.parameters import Parameters
from maidenflight.policy import Policy
from maidenflight.simulator.physics import dynamics
from maidenflight.training.scores import Scores


def write_policies(
    folder: Path,
    policies: Sequence[Policy],
    record: dict[str, Any],
    drone: Parameters,
    scores: Scores,
    faults: Mapping[int, str],
) -> manifest.Files:
    """Writes policies with what an export needs to know of their drone, and their scores.

    Args:
        folder: for the files.
        policies: in the order of their numbers, from 1.
        record: of the training.
        drone: which they were trained for.
        scores: of the training.
        faults: what speaks against a policy, by its number; a doubt in its file.

    Returns:
        The files by kind.
    """
    hover = round(float(dynamics.hover_command(drone)), 6)
    rotors = {name: parameters.plain(getattr(drone, name)) for name in parameters.GEOMETRY}
    doubts = {
        number: {"doubts": [*record.get("doubts", []), fault]} for number, fault in faults.items()
    }
    settings, updates = record["settings"], scores.updates
    written = [
        policy_file.write_policy(
            run_folder.POLICY.path(folder, number),
            policy,
            {
                **record,
                **doubts.get(number, {}),
                "settings": {**settings, "updates": updates[number - 1]},
                "hover": hover,
                "rotors": rotors,
                "number": number,
            },
        )
        for number, policy in enumerate(policies, 1)
    ]
    table = run_folder.TRAINING.write(folder / run_folder.TRAINING.name, scores.table)
    _remove_older(folder, len(policies))
    return {"policies": written, "training": [table]}


def _remove_older(folder: Path, count: int) -> None:
    """Removes policies of an earlier training that had more of them."""
    for path in run_folder.POLICY.find(folder):
        number = path.stem.removeprefix("policy_")
        with suppress(InputError):
            if (
                number.isdecimal()
                and int(number) > count
                and policy_file.read_policy(path).record.get("number") == int(number)
            ):
                path.unlink()


def how_to_start(folder: Path) -> str:
    """Returns what to do if there is no checkpoint to resume from."""
    if (folder / run_folder.TRAINING.name).exists():
        return (
            "The policies there are of a training whose state is gone. Give --overwrite instead "
            "of --resume to train others in their place."
        )
    started = folder.is_dir() and set(folder.iterdir()) > set(results.leftovers(folder))
    return (
        "Give --overwrite instead of --resume to start one."
        if started
        else "Leave out --resume to start one."
    )
