"""Checkpoints of training: arrays in NumPy's format, with a fingerprint of what is trained.

Each belongs to an evaluation of a stage of training. Reading one never runs code from it.
"""

import hashlib
import io
import json
import math
import os
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np
from jax import tree
from jax.experimental import multihost_utils

from maidenflight import __version__, budget, inputs, results
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath

T = TypeVar("T")
_TITLE = "maidenflight checkpoint 2"
_DAMAGED = (
    *(
        OSError,
        ValueError,
        TypeError,
        LookupError,
        AttributeError,
        EOFError,
        MemoryError,
        RuntimeError,
    ),
    *(zipfile.BadZipFile, zlib.error, struct.error),
)
"""What NumPy and its archive readers raise for damaged bytes."""


class Checkpoint(NamedTuple):
    """Place of a training's state."""

    path: StrPath
    restart: bool = False
    """Whether to begin anew; an earlier checkpoint stays until the first of this training."""
    members: Sequence[int] | None = None
    """Policies whose training an extension goes on with, from 0; all by default."""


def fingerprint(words: Mapping[str, Any], numbers: Any) -> str:
    """Identifies a training: a hash, and the settings in one line to name differences.

    Args:
        words: settings, plain values.
        numbers: a pytree of arrays, compared bit by bit.
    """
    description = json.dumps(words, sort_keys=True)
    text = hashlib.sha256(description.encode())
    for leaf in tree.leaves(numbers):
        array = np.asarray(leaf)
        text.update(f"{array.dtype} {array.shape}".encode() + array.tobytes())
    return f"{text.hexdigest()[:16]} {description}"


def _difference(stored: str, expected: str) -> str:
    """Names what differs between two fingerprints; empty if it cannot be read from them."""
    if stored == expected:
        return ""
    try:
        before, now = (_flat(json.loads(line.partition(" ")[2])) for line in (stored, expected))
    except (ValueError, AttributeError, RecursionError):
        return ""
    names = [name for name in {**before, **now} if before.get(name) != now.get(name)]
    if not names:
        return ": it had another seed, drone, or randomization"
    return ": " + ", ".join(
        f"{name} was {json.dumps(before.get(name))} and is {json.dumps(now.get(name))}"
        for name in names
    )


def _flat(words: Mapping[str, Any]) -> dict[str, Any]:
    """All values, those of `settings` on the same level."""
    words = dict(words)
    return {**words.pop("settings", {}), **words}


def save(path: str | PathLike[str], state: Any, fingerprint: str, stages: Sequence[int]) -> None:
    """Writes a state of training, whole or not at all.

    Of several processes that train together, only the first writes.

    Args:
        path: file to write.
        state: a pytree of arrays.
        fingerprint: of this training.
        stages: number of updates after which training was or is to end, and those after which it
            was extended from there.

    Raises:
        WriteError: the file cannot be written; its former content stays.
    """
    leaves = {f"leaf {number}": _whole(leaf) for number, leaf in enumerate(tree.leaves(state))}
    if jax.process_index() > 0:
        return
    file = io.BytesIO()
    title = [_TITLE, __version__, " ".join(map(str, stages)), fingerprint]
    np.savez(file, title=np.array("\n".join(title)), **leaves)  # type: ignore[arg-type]
    results.write(path, file.getvalue())


def _whole(leaf: Any) -> np.ndarray:
    if isinstance(leaf, jax.Array) and not leaf.is_fully_addressable:
        return multihost_utils.process_allgather(leaf, tiled=True)
    return np.asarray(leaf)


class _Saved(NamedTuple):
    """What a file holds."""

    fingerprint: str
    stages: tuple[int, ...]
    leaves: list[np.ndarray]


def _check_head(packed: zipfile.ZipFile, entry: str) -> None:
    """Checks that an array's numbers are there, before NumPy makes room for them.

    Raises:
        ValueError: they are not.
    """
    with packed.open(entry) as file:
        version = np.lib.format.read_magic(file)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else None
        shape, _, kind = (read or np.lib.format.read_array_header_2_0)(file)
    if math.prod(shape) * kind.itemsize > packed.getinfo(entry).file_size:
        raise ValueError(f"{entry} is of shape {shape}, which is not there")


def _read(path: str | PathLike[str]) -> _Saved:
    """What `save` wrote.

    Raises:
        InputError: the file is damaged, or of another version.
    """
    try:
        raw = inputs.content(path, budget.NETWORK)
        with budget.NETWORK.open_zip(raw) as packed:
            for entry in packed.namelist():
                _check_head(packed, entry)
        with np.load(io.BytesIO(raw), allow_pickle=False) as content:
            title, version, *words = str(content["title"]).split("\n")
            stages, fingerprint = words if title == _TITLE else ("", "")
            saved = _Saved(
                fingerprint,
                tuple(map(int, stages.split())),
                [np.asarray(content[f"leaf {number}"]) for number in range(len(content.files) - 1)],
            )
    except _DAMAGED as error:
        raise InputError(
            f"{path}: not a checkpoint of training ({error}). Remove it to start again."
        ) from error
    if title != _TITLE or version != __version__:
        raise InputError(
            f"{path}: a checkpoint of maidenflight {version}; this is {__version__}. Finish it "
            "there, or remove it to start again."
        )
    return saved


def stages(path: str | PathLike[str]) -> tuple[int, ...]:
    """Numbers of updates that `save` wrote, or none if there is no such file.

    Raises:
        InputError: the file is damaged, or of another version.
    """
    return _read(path).stages if os.path.lexists(path) else ()


def restored(
    path: str | PathLike[str], start: Callable[[tuple[int, ...]], T], expected: str
) -> tuple[T, tuple[int, ...]]:
    """Returns the state in a file and its stages, or a new one and none if there is no such file.

    Args:
        path: of `save`.
        start: (stages) to a new state; the file's arrays must have its shapes.
        expected: fingerprint of this training.

    Raises:
        InputError: the file is damaged, or of another training.
    """
    if not os.path.lexists(path):
        return start(()), ()
    stored = _read(path)
    if stored.fingerprint == expected:
        shapes, structure = tree.flatten(jax.eval_shape(lambda: start(stored.stages)))
        if [(leaf.shape, leaf.dtype) for leaf in stored.leaves] == [
            (shape.shape, shape.dtype) for shape in shapes
        ]:
            return tree.unflatten(structure, stored.leaves), stored.stages
    raise InputError(
        f"{path}: a checkpoint of another training{_difference(stored.fingerprint, expected)}. "
        "Give the settings, seed and drone that it was started with, or another folder."
    )


def extended(
    path: str | PathLike[str] | None,
    stages: tuple[int, ...],
    updates: int,
    evaluations: int,
    scored: int,
    from_zero: bool,
) -> tuple[int, ...]:
    """Stages of a training that goes on from a checkpoint to a number of updates.

    Args:
        path: the checkpoint.
        stages: of the checkpoint; none where there is none.
        updates: after which training is to end.
        evaluations: see `ends`.
        scored: number of evaluations that the checkpoint holds.
        from_zero: see `ends`.

    Raises:
        InputError: it has more updates, or fewer and has not ended.
    """
    last = (stages or (0,))[-1]
    ended = scored == len(ends(stages, evaluations, from_zero))
    if updates == last or (updates > last and ended):
        return stages if updates == last else (*stages, updates)
    remedy = (
        f"Give {last}, or more to train further"
        if ended
        else f"Finish it with updates = {last}; then it can be extended"
    )
    raise InputError(
        f"{path}: a checkpoint of another training: updates was {last} and is {updates}. {remedy}."
    )


def ends(stages: Sequence[int], evaluations: int, from_zero: bool) -> list[int]:
    """Updates after which policies are evaluated: evenly spaced in each stage, the last at its end.

    Args:
        stages: numbers of updates after which training ends, ascending.
        evaluations: in the first stage; as often per update in the others.
        from_zero: whether the policy is evaluated before the first update, too.
    """
    updates, first = [0] * (from_zero and bool(stages)), 0
    for end in stages:
        per_update = min(1.0, evaluations / stages[0])
        count = max(1, round((end - first) * per_update))
        updates += [first + round((end - first) * number / count) for number in range(1, count + 1)]
        first = end
    return updates
