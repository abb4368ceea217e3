"""Networks in ONNX, for `described.DescribedPolicy`. Needs onnxruntime (extra `onnx`)."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from maidenflight.errors import InputError, optional

Network = Callable[[Float[np.ndarray, "N"]], Float[np.ndarray, "..."]]
"""Inputs to outputs; raises `ValueError` where there are more or fewer inputs than it takes."""


def network(path: Path, output: str | None, place: str) -> Network:
    """Returns the network of a file.

    Args:
        path: the ONNX file.
        output: name of the output that commands the motors; the first one by default.
        place: the file that named the output.

    Raises:
        InputError: onnxruntime is not installed, the file is no network, or it lacks the output.
    """
    session = _session(path)
    names = [one.name for one in session.get_outputs()]
    output_name, input_name = output or names[0], session.get_inputs()[0].name
    if output_name not in names:
        raise InputError(f"{place}: output = {output_name!r}; the network has {', '.join(names)}.")

    def run(numbers: np.ndarray) -> np.ndarray:
        try:
            (result,) = session.run([output_name], {input_name: numbers[None].astype(np.float32)})
        except Exception as error:  # onnxruntime's errors share no class but this
            raise ValueError(str(error)) from error
        return result

    return run


def _session(path: Path) -> Any:
    """The network, ready to run."""
    with optional("onnxruntime", "onnx", "a policy in ONNX"):
        import onnxruntime
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    try:
        return onnxruntime.InferenceSession(str(path), options)
    except Exception as error:  # onnxruntime's errors share no class but this
        raise InputError(
            f"{path}: not a network in ONNX ({str(error).splitlines()[0]:.120})."
        ) from error
