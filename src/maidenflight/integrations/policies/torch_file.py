"""Tensors as PyTorch saves them, read without PyTorch: a zip file of a pickle and of raw numbers.

Source: PyTorch, `torch/serialization.py` (`_save`) and `torch/_utils.py` (`_rebuild_tensor_v2`).
"""

import math
import zipfile
from typing import Any

import numpy as np

from maidenflight import budget
from maidenflight.integrations.policies.pickled import Made, Name, read_pickle

_STORAGES = {
    "torch.FloatStorage": np.float32,
    "torch.DoubleStorage": np.float64,
    "torch.HalfStorage": np.float16,
}


class _Storages:
    """The numbers of a file by key, each read once."""

    def __init__(self, file: zipfile.ZipFile, folder: str) -> None:
        self._file, self._folder = file, folder
        self._read: dict[str, np.ndarray] = {}

    def get(self, kind: Any, key: str) -> np.ndarray:
        """Returns the numbers that a tensor names."""
        if not isinstance(kind, Name) or str(kind) not in _STORAGES:
            raise ValueError(f"a tensor of {kind!s:.60}")
        if key not in self._read:
            raw = self._file.read(f"{self._folder}{key}")
            self._read[key] = np.frombuffer(raw, _STORAGES[str(kind)])
        return self._read[key]


def read_tensors(content: bytes) -> dict[str, np.ndarray]:
    """Returns the tensors of a `state_dict` by name.

    Raises:
        ValueError, LookupError, TypeError, AttributeError, zipfile.BadZipFile: it is damaged, holds
            other things, or more than `budget.NETWORK` allows.
    """
    with budget.NETWORK.open_zip(content) as file:
        names = file.namelist()
        pickle_name = next(name for name in [*names, "data.pkl"] if name.endswith("data.pkl"))
        root = pickle_name.removesuffix("data.pkl")
        if f"{root}byteorder" in names and file.read(f"{root}byteorder") != b"little":
            raise ValueError("numbers of another byte order")
        held = read_pickle(file.read(pickle_name))
        entries = held.entries if isinstance(held, Made) else held
        storages, total = _Storages(file, f"{root}data/"), 0
        tensors: dict[str, np.ndarray] = {}
        for name, value in entries.items():
            view = _tensor(value, storages)
            total += view.size
            budget.NETWORK.check("numbers", total)
            tensors[str(name)] = view.copy()
        return tensors


def _tensor(value: Any, storages: _Storages) -> np.ndarray:
    """A view of a tensor's numbers."""
    if not isinstance(value, Made) or value.name != "torch._utils._rebuild_tensor_v2":
        raise ValueError(f"{getattr(value, 'name', value)!s:.60} for a tensor")
    storage, offset, shape, strides, *_ = value.arguments
    _, kind, key, *_ = storage.arguments
    numbers = storages.get(kind, key)
    last = sum((size - 1) * stride for size, stride in zip(shape, strides, strict=True))
    sound = all(type(number) is int and number >= 0 for number in (offset, *shape, *strides))
    if not sound or math.prod(shape) > len(numbers) or offset + last >= max(1, len(numbers)):
        raise ValueError("a tensor of more numbers than are there")
    steps = [stride * numbers.itemsize for stride in strides]
    return np.lib.stride_tricks.as_strided(numbers[offset:], shape, steps, writeable=False)
