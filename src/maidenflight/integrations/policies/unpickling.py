"""Reading pickled files of Stable-Baselines3 without running their code.

A pickle names functions that are called as it is read, so that one from a stranger runs anything.
Here only classes and constructors of numbers, spaces, networks and scalings are let through; what
else is named is refused, and nothing of it is imported.

Source: Python, docs of `pickle`, section Restricting Globals.
"""

import base64
import importlib
import io
import pickle
import zipfile
from collections.abc import Collection
from typing import Any

from maidenflight import inputs
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath

_FUNCTIONS = {
    "numpy": {"dtype", "ndarray"},
    "numpy._core.multiarray": {"_reconstruct", "scalar"},
    "numpy.core.multiarray": {"_reconstruct", "scalar"},
    "numpy._core.numeric": {"_frombuffer"},
    "numpy.core.numeric": {"_frombuffer"},
    "numpy.random._pickle": {"__bit_generator_ctor", "__generator_ctor", "__randomstate_ctor"},
    "numpy.random.bit_generator": {"__pyx_unpickle_SeedSequence"},
    "collections": {"OrderedDict", "defaultdict", "deque"},
    "builtins": {"set", "frozenset", "slice", "range", "complex", "int", "float", "bool", "dict"},
}
"""What a pickle may call, by module."""
_CLASSES = (
    *("numpy.dtypes", "numpy.random._pcg64", "numpy.random._mt19937", "gymnasium.spaces"),
    *("numpy.random.bit_generator", "stable_baselines3", "torch.nn", "torch.optim"),
)
"""Modules of which, with what lies in them, classes may be made."""
_SERIALIZED = ":serialized:"


class _Reader(pickle.Unpickler):
    """Reads numbers and known classes only."""

    def find_class(self, module: str, name: str) -> Any:
        """Returns what a pickle names.

        Raises:
            pickle.UnpicklingError: it may not be called.
        """
        known = name in _FUNCTIONS.get(module, ())
        inside = any(module == one or module.startswith(f"{one}.") for one in _CLASSES)
        if (known or inside) and "." not in name:
            part = getattr(importlib.import_module(module), name)
            if known or isinstance(part, type):
                return part
        raise pickle.UnpicklingError(f"it names {module}.{name}, which could run any code")


def unpickled(content: bytes) -> Any:
    """Returns what a pickle holds.

    Raises:
        pickle.UnpicklingError: it names what is not known; or see `pickle.loads`.
    """
    return _Reader(io.BytesIO(content)).load()


def data_of(path: StrPath) -> dict[str, Any]:
    """Returns the settings that a `model.zip` holds.

    Raises:
        ValueError: it is damaged, or grows more than such files do.
        OSError: it cannot be read.
        KeyError: it holds none.
        zipfile.BadZipFile: it is no such file.
    """
    with zipfile.ZipFile(path) as file:
        entries = file.infolist()
        packed = sum(entry.compress_size for entry in entries)
        inputs.check_growth(packed, sum(entry.file_size for entry in entries))
        return inputs.from_json(file.read("data").decode())


def objects_of(path: StrPath, unused: Collection[str]) -> dict[str, Any]:
    """Returns pickled objects of a `model.zip`, by name, which its own reader need not read then.

    Args:
        path: of the file.
        unused: objects that are not needed, such as schedules of training, and stay unread.

    Raises:
        InputError: one names what is not known, or the file is damaged.
    """
    values = {}
    try:
        data = data_of(path)
        for name, entry in data.items():
            if isinstance(entry, dict) and _SERIALIZED in entry and name not in unused:
                values[name] = unpickled(base64.b64decode(entry[_SERIALIZED]))
    except Exception as error:  # whatever a damaged pickle raises
        raise InputError(
            f"{path}: cannot be read without running code in it ({error!s:.160}). Only files "
            "that hold numbers, spaces and networks are read."
        ) from error
    return values
