"""Checks of functions that users write for the simulator."""

from collections.abc import Callable
from typing import Any

import jax

from maidenflight.errors import InputError


def check_traced(name: str, function: Callable[..., Any], expected: str, *arguments: Any) -> Any:
    """Returns the shapes of what a user's function of arrays gives, if JAX can trace it.

    Nothing is computed. `expected` says for errors what it takes and gives, `arguments` are arrays
    or their shapes.

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
