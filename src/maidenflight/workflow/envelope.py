"""Envelopes of policies from files."""

from collections.abc import Callable, Sequence
from pathlib import Path

import jax
import polars

from maidenflight import manifest, results, run_folder
from maidenflight.deployment.authors_json import read_policy
from maidenflight.errors import InputError
from maidenflight.experiments import envelope
from maidenflight.inputs import StrPath
from maidenflight.reporting.envelope_picture import envelope_picture
from maidenflight.simulator import tasks
from maidenflight.simulator.reality import AnyReality
from maidenflight.workflow.policies import names, own_and_foreign, policy_files


def envelope_of(
    given: Sequence[StrPath],
    realities: Sequence[AnyReality],
    axes: Sequence[str],
    seed: int,
    folder: StrPath,
    *,
    flights: int = 20,
    task: str = "circle",
    resume: bool = False,
    on_axis: Callable[[int, int, str], None] | None = None,
) -> polars.DataFrame:
    """Flies policies along axes of difficulty in realities.

    Writes `envelope.csv` with a row a flight, whole again after each axis, and `envelope.svg`.

    Args:
        given: policy files, and folders of them, of one kind, and policies by others.
        realities: where to fly.
        axes: names of `envelope.AXES`.
        seed: random seed.
        folder: where to write.
        flights: of each policy along each axis.
        task: what is flown under a condition.
        resume: go on with what an interrupted run has left in the folder.
        on_axis: called with (axes flown, axes in all realities, what is next).

    Returns:
        A row a flight, as `envelope.envelope` gives.

    Raises:
        InputError: see `envelope.envelope`; or the folder holds an envelope of other settings.
    """
    own, others = own_and_foreign(given)
    files = policy_files(own)
    policies = [*(read_policy(path) for path in files), *others]
    called = [*names(files), *(one.name for one in others)]
    settings = {
        **({"foreign": [one.name for one in others]} if others else {}),
        "realities": [place.name for place in realities],
        "axes": list(axes),
        "flights": flights,
        "task": task,
        "within": envelope.WITHIN_M,
    }
    described = [path for path in given if Path(path).suffix in (".toml", ".zip")]
    made = results.plain(results.record(seed=seed, inputs=[*files, *described], settings=settings))
    path = Path(folder, run_folder.ENVELOPE.name)
    parts = _found(path, made) if resume else {}
    plan = [(place, axis) for place in realities for axis in axes]
    for number, (place, axis) in enumerate(plan):
        if (place.name, axis) in parts:
            continue
        if on_axis is not None:
            on_axis(number, len(plan), f"{axis} in {place.name}")
        parts[place.name, axis] = envelope.envelope(
            policies,
            place,
            axis,
            flights=flights,
            key=jax.random.key(seed),
            task=tasks.TASKS[task](),
            names=called,
        )
        run_folder.ENVELOPE.write(path, polars.concat(parts.values()), made)
    flown = polars.concat(parts[place.name, axis] for place, axis in plan)
    run_folder.ENVELOPE.write(path, flown, made)
    picture = path.with_suffix(".svg")
    results.write(picture, envelope_picture(envelope.summary(flown)))
    written: manifest.Files = {"envelope": [path], "picture": [picture]}
    manifest.append(folder, "envelope", written, made, {"policies": [*files, *described]})
    return flown


def best_by_envelope(summary: polars.DataFrame, files: Sequence[Path]) -> Path:
    """The policy with the widest envelope: its mean share of each axis, in all realities.

    Of what `envelope.summary` gives, and the files of ours that were flown.
    """
    own = summary.filter(polars.col("policy").is_in(names(files)))
    share = (polars.col("envelope").fill_nan(0.0) / polars.col("hardest")).mean()
    order = own.group_by("policy", maintain_order=True).agg(share.alias("share"))
    name = order.sort("share", descending=True, maintain_order=True)["policy"][0]
    return next(path for path, called in zip(files, names(files), strict=True) if called == name)


def _found(path: Path, made: dict[str, object]) -> dict[tuple[str, str], polars.DataFrame]:
    """What an interrupted run has left, by reality and axis."""
    if not path.is_file():
        return {}
    rows, record = run_folder.ENVELOPE.read(path)
    if record != made:
        raise InputError(
            f"{path}: of other policies, settings or another version. Give another folder (-o), or "
            "--overwrite instead of --resume."
        )
    return {
        (str(place), str(axis)): part
        for (place, axis), part in rows.group_by("reality", "axis", maintain_order=True)
    }
