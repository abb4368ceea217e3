"""Vectors as their entries, and lengths of vectors with a gradient at zero."""

from collections.abc import Callable, Iterable, Iterator
from functools import reduce
from operator import add, mul, neg, sub, truediv
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import tree
from jaxtyping import Array, Float

Tree = TypeVar("Tree")


@jax.tree_util.register_pytree_node_class
class Entries:
    """A vector as its entries, with the arithmetic of an array.

    Over many drones each entry is an array with one number a drone, and XLA makes of a formula a
    few loops that the processor's vector units do whole. Of arrays with three or four numbers a
    drone, whose entries are cut out and stacked, it makes loops of single numbers: physics then
    takes twice as long (paper/notes/roofline.md).
    """

    __array_ufunc__ = None
    """So that NumPy leaves the arithmetic to this class."""

    def __init__(self, numbers: Iterable[Any]):
        self._numbers = tuple(numbers)

    def __iter__(self) -> Iterator[Any]:
        return iter(self._numbers)

    def __len__(self) -> int:
        return len(self._numbers)

    def __getitem__(self, number: int) -> Any:
        return self._numbers[number]

    def tree_flatten(self) -> tuple[tuple[Any, ...], None]:
        """Its entries are a pytree's leaves."""
        return self._numbers, None

    @classmethod
    def tree_unflatten(cls, _: None, numbers: Iterable[Any]) -> "Entries":
        """Returns entries of a pytree's leaves."""
        return cls(numbers)

    def _with(self, operation: Callable[[Any, Any], Any], other: Any) -> "Entries":
        whole = isinstance(other, Entries) or jnp.ndim(other)
        others = other if whole else [other] * len(self)
        return Entries(operation(entry, by) for entry, by in zip(self, others, strict=True))

    def __add__(self, other: Any) -> "Entries":
        return self._with(add, other)

    def __sub__(self, other: Any) -> "Entries":
        return self._with(sub, other)

    def __rsub__(self, other: Any) -> "Entries":
        return self._with(lambda entry, by: by - entry, other)

    def __mul__(self, other: Any) -> "Entries":
        return self._with(mul, other)

    def __truediv__(self, other: Any) -> "Entries":
        return self._with(truediv, other)

    def __neg__(self) -> "Entries":
        return Entries(map(neg, self))

    __radd__ = __add__
    __rmul__ = __mul__


def entries(vectors: Tree) -> Tree:
    """Returns a pytree with its vectors as `Entries`; scalars stay what they are."""
    return tree.map(lambda leaf: Entries(leaf) if jnp.ndim(leaf) else leaf, vectors)


def like(template: Any, computed: Iterable[Any]) -> Any:
    """Returns a vector of some entries, in the form of another: an array or `Entries`."""
    return Entries(computed) if isinstance(template, Entries) else jnp.stack(list(computed))


def each(function: Callable[..., Any], *vectors: Any) -> Any:
    """Returns a function of numbers, of the entries of each vector."""
    if any(isinstance(vector, Entries) for vector in vectors):
        return Entries(function(*numbers) for numbers in zip(*vectors, strict=True))
    return function(*vectors)


def norm(vector: Float[Array, "n"] | tuple[Array, ...]) -> Float[Array, ""]:
    """Returns the Euclidean norm, whose gradient at zero is zero, not NaN."""
    square = squared(vector)
    return jnp.where(square == 0, 0.0, jnp.sqrt(jnp.where(square == 0, 1.0, square)))


def squared(vector: Float[Array, "n"] | tuple[Array, ...]) -> Float[Array, ""]:
    """Returns the sum of squares, written out as in `dynamics`."""
    return reduce(add, [entry * entry for entry in vector])
