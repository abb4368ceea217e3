"""Checks of functions that users write for the simulator."""

from collections.abc import Callable
from typing import Any

import jax

from maidenflight.errors import InputError


def check_traced(name: str, function: Callable[..., Any], expected: str, *arguments: Any) -> Any:
    """Checks that JAX can trace a function of arrays that a user has written.

    Args:
        name: of the function, for errors.
        function: to be tried; nothing is computed.
        expected: what it takes and gives, for errors.
        arguments: arrays, or their shapes.

    Returns:
        The shapes of what it gives.

    Raises:
        InputError: it raises an error, or JAX cannot trace it.
    """
    try:
        return jax.eval_shape(function, *arguments)
    except (TypeError, AttributeError, ValueError, IndexError, jax.errors.JAXTypeError) as error:
        raise InputError(
            f"{name} is not a function that JAX can trace: {type(error).__name__}: {error} Expected"
            f" {expected}, by functions of jax.numpy, without if."
        ) from error
