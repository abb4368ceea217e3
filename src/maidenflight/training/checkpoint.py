"""Checkpoints of training: arrays in NumPy's format, with a fingerprint of what is trained.

Reading one never runs code from it.
"""

import hashlib
import io
import json
import os
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping
from os import PathLike
from typing import Any, TypeVar

import jax
import numpy as np
from jax import tree
from jax.experimental import multihost_utils

from maidenflight import __version__, inputs, results
from maidenflight.errors import InputError

T = TypeVar("T")
_TITLE = "maidenflight checkpoint 1"
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


def fingerprint(words: Mapping[str, Any], numbers: Any) -> str:
    """Identifies a training: a hash, and the settings in one line to name differences.

    Args:
        words: settings, plain values.
        numbers: a pytree of arrays, compared bit by bit.
    """
    said = json.dumps(words, sort_keys=True)
    text = hashlib.sha256(said.encode())
    for leaf in tree.leaves(numbers):
        array = np.asarray(leaf)
        text.update(f"{array.dtype} {array.shape}".encode() + array.tobytes())
    return f"{text.hexdigest()[:16]} {said}"


def _difference(found: str, expected: str) -> str:
    """Names what differs between two fingerprints; empty if it cannot be read from them."""
    if found == expected:
        return ""
    try:
        before, now = (_flat(json.loads(one.partition(" ")[2])) for one in (found, expected))
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


def save(path: str | PathLike[str], state: Any, fingerprint: str) -> None:
    """Writes a state of training, whole or not at all.

    Of several processes that train together, only the first writes.

    Raises:
        WriteError: the file cannot be written; what was there before is kept.
    """
    leaves = {f"leaf {number}": _whole(leaf) for number, leaf in enumerate(tree.leaves(state))}
    if jax.process_index() > 0:
        return
    file = io.BytesIO()
    np.savez(file, title=np.array(f"{_TITLE}\n{__version__}\n{fingerprint}"), **leaves)  # type: ignore[arg-type]
    results.write(path, file.getvalue())


def _whole(leaf: Any) -> np.ndarray:
    if isinstance(leaf, jax.Array) and not leaf.is_fully_addressable:
        return multihost_utils.process_allgather(leaf, tiled=True)
    return np.asarray(leaf)


def restored(path: str | PathLike[str], start: Callable[[], T], expected: str) -> T:
    """The state in a file, or a new one if there is no such file.

    Args:
        path: as given to `save`.
        start: makes a new state; the file's arrays must have its shapes.
        expected: fingerprint of this training.

    Raises:
        InputError: the file is damaged, or of another training.
    """
    if not os.path.lexists(path):
        return start()
    remedy = "Give the settings, seed and drone that it was started with, or another folder."
    shapes, structure = tree.flatten(jax.eval_shape(start))
    try:
        with np.load(io.BytesIO(inputs.content(path)), allow_pickle=False) as content:
            title, version, found = str(content["title"]).split("\n")
            leaves = [np.asarray(content[f"leaf {number}"]) for number in range(len(shapes))]
            whole = len(content.files) == len(shapes) + 1
    except _DAMAGED as error:
        raise InputError(
            f"{path}: not a checkpoint of training ({error}). Remove it to start again."
        ) from error
    if title != _TITLE or version != __version__:
        raise InputError(
            f"{path}: a checkpoint of maidenflight {version}; this is {__version__}. Finish it "
            "there, or remove it to start again."
        )
    sound = whole and all(
        leaf.shape == shape.shape and leaf.dtype == shape.dtype
        for leaf, shape in zip(leaves, shapes, strict=True)
    )
    if found != expected or not sound:
        raise InputError(
            f"{path}: a checkpoint of another training{_difference(found, expected)}. {remedy}"
        )
    return tree.unflatten(structure, [jax.numpy.asarray(leaf) for leaf in leaves])
