"""What a reader of files is to the fuzzer, and how its good files are damaged."""

import importlib
import random
import sys
import tomllib
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import fuzz_damage as damage
import fuzz_trees
import numpy as np
from fuzz_damage import Damaged, Kind

TESTS = Path(__file__).parents[1] / "tests"


class Good(NamedTuple):
    """A good file, and how it is damaged."""

    place: str
    content: bytes
    damaged: Callable[[random.Random, bytes, bytes], Damaged]


class Reader(NamedTuple):
    """What reads one kind of files."""

    name: str
    weight: float
    """Share of all inputs, before all shares are made to sum to 1."""
    good: tuple[Good, ...]
    read: Callable[[Path, Path], Any]
    """(folder, damaged file) to what was understood."""
    told: Callable[[Any], list[np.ndarray]]
    """What was understood, as arrays that can be compared; rows first."""
    unsound: Callable[[Any], str]
    """What is wrong with something that was accepted; nothing where it is sound."""
    notes: Callable[[Any], Sequence[str]] = lambda _: ()
    around: Mapping[str, bytes] = {}
    """Further files of the folder."""
    lenient: bool = False
    """Whether a file that cannot be read is passed over, by design."""


def made(name: str) -> Any:
    """A module of the tests, which know how to make good files."""
    for folder in ("", "flights/maps", "integrations/logs", "reporting"):
        if str(TESTS / folder) not in sys.path:
            sys.path.append(str(TESTS / folder))
    return importlib.import_module(name)


def toml(content: bytes) -> dict[str, Any]:
    return tomllib.loads(content.decode())


def table_damaged(
    needed: Sequence[str], truncated: str, shown: Sequence[str] = ()
) -> Callable[[random.Random, bytes, bytes], Damaged]:
    """How a CSV is damaged."""

    def damaged(generator: random.Random, good: bytes, other: bytes) -> Damaged:
        chance = generator.random()
        if chance < 0.6:
            return damage.of_table(generator, good, needed, shown)
        if chance < 0.65:
            return damage.of_encoding(generator, good)
        return damage.of_bytes(generator, good, other, Kind(truncated))

    return damaged


def tree_damaged(
    parse: Callable[[bytes], dict[str, Any]],
    needed: Callable[[tuple[Any, ...]], bool],
    language: str,
    kind: Kind,
) -> Callable[[random.Random, bytes, bytes], Damaged]:
    """How a file of JSON or TOML is damaged."""
    known = cache(parse)

    def damaged(generator: random.Random, good: bytes, other: bytes) -> Damaged:
        chance = generator.random()
        if chance < 0.6:
            return fuzz_trees.of_tree(generator, known(good), needed, language)
        if chance < 0.65:
            return damage.of_encoding(generator, good)
        return damage.of_bytes(generator, good, other, kind)

    return damaged
