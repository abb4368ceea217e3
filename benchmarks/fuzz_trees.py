"""Random, seeded damage to the values and keys of JSON and TOML; verdicts as in `fuzz_damage`."""

import json
import random
from collections.abc import Callable, Sequence
from typing import Any

import tomlkit
from fuzz_damage import ANY, REFUSED, Damaged

_RAW = "@raw@"
LEAVES: tuple[Any, ...] = (
    *(
        f"{_RAW}{token}"
        for token in ("NaN", "Infinity", "-Infinity", "1e400", "1" * 5000, "[" * 3000 + "]" * 3000)
    ),
    *(
        None,
        True,
        False,
        "",
        "text",
        "0.5",
        "a" * 100_000,
        "\u0000",
        "a\nb",
        [],
        {},
        [[]],
        [1.0, [2.0]],
        {"a": 1},
        10**30,
    ),
)
"""What can never stand for a number that is needed."""
NUMBERS: tuple[Any, ...] = (
    -1,
    0,
    1,
    -0.0,
    2**31,
    2**63,
    1e-320,
    1e-30,
    1e38,
    1e39,
    1e300,
    -1e300,
    0.5,
    2.5,
    1000,
    1001,
)
"""Numbers, which may or may not make sense."""


def of_tree(
    generator: random.Random,
    good: dict[str, Any],
    needed: Callable[[tuple[Any, ...]], bool],
    language: str,
) -> Damaged:
    """A tree of tables, lists and values, damaged in one place and written as JSON or TOML.

    Args:
        generator: of randomness.
        good: the tree.
        needed: whether what stands at a path must be there and be of its type.
        language: `json` or `toml`.
    """
    tree = json.loads(json.dumps(good))
    path = _somewhere(generator, tree)
    parent = _at(tree, path[:-1])
    old = parent[path[-1]]
    wanted = REFUSED if needed(path) else ANY
    number = isinstance(old, int | float) and not isinstance(old, bool)

    def replaced(new: Any, verdict: str) -> str:
        parent[path[-1]] = new
        return verdict

    def removed() -> str:
        del parent[path[-1]]
        return wanted if isinstance(parent, dict) else ANY

    def renamed() -> str:
        if not isinstance(parent, dict):
            parent.append(old)
            return ANY
        parent[f"{path[-1]}_"] = parent.pop(path[-1])
        return wanted

    def twice() -> str:
        if not isinstance(parent, dict):
            parent.insert(0, old)
            return ANY
        parent[f"@twice@{path[-1]}"] = old
        return REFUSED

    def swapped() -> str:
        places = list(parent) if isinstance(parent, dict) else range(len(parent))
        place = generator.choice(list(places))
        parent[path[-1]], parent[place] = parent[place], parent[path[-1]]
        return ANY

    def beside() -> str:
        (parent if isinstance(parent, dict) else tree)["unknown_key"] = generator.choice(LEAVES[6:])
        return ANY

    makes: dict[str, Callable[[], str]] = {
        "a value of another type": lambda: replaced(
            generator.choice(LEAVES), wanted if number else ANY
        ),
        "another number": lambda: replaced(generator.choice(NUMBERS), ANY),
        "a value in a list": lambda: replaced([old], wanted),
        "a key missing": removed,
        "a key renamed": renamed,
        "a key twice": twice,
        "values swapped": swapped,
        "a key too many": beside,
    }
    what = generator.choice([*makes, "a value of another type", "another number"])
    verdict = makes[what]()
    return Damaged(
        _written(tree, language).encode("utf-8", "surrogatepass"),
        f"{what} at {'.'.join(map(str, path))[:40]}",
        verdict,
    )


def _somewhere(generator: random.Random, tree: Any) -> tuple[Any, ...]:
    """A path into the tree; all depths alike."""
    path: list[Any] = []
    while isinstance(tree, dict | list) and tree and (not path or generator.random() < 0.75):
        path.append(generator.choice(list(tree) if isinstance(tree, dict) else range(len(tree))))
        tree = tree[path[-1]]
    return tuple(path)


def _at(tree: Any, path: Sequence[Any]) -> Any:
    for step in path:
        tree = tree[step]
    return tree


def _written(tree: Any, language: str) -> str:
    if language == "json":
        text = json.dumps(tree)
    else:
        text = tomlkit.dumps(_without_none(tree))
        text = (
            text.replace(f"{_RAW}NaN", f"{_RAW}nan")
            .replace(f"{_RAW}Infinity", f"{_RAW}inf")
            .replace(f"{_RAW}-Infinity", f"{_RAW}-inf")
        )
    return _unquoted(text).replace("@twice@", "")


def _without_none(tree: Any) -> Any:
    """TOML has no null; an empty table comes nearest."""
    if isinstance(tree, dict):
        return {name: _without_none(value) for name, value in tree.items()}
    return (
        [_without_none(value) for value in tree]
        if isinstance(tree, list)
        else {}
        if tree is None
        else tree
    )


def _unquoted(text: str) -> str:
    parts = text.split(f'"{_RAW}')
    return parts[0] + "".join(part.replace('"', "", 1) for part in parts[1:])
