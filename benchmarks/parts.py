"""Counts what a contributor has to hold in the head.

tests/repository/test_architecture.py keeps it from rising.

python benchmarks/parts.py  # prints all of it

- *Closure*: files that a verb's modules import, at their top or inside a function, and theirs.
- *Walk*: functions, methods and classes of ours that an entry calls by name, and those that these
  call: their number (stops), their modules, and the names that they and their arguments bear. What
  is called on an object of unknown class is not followed.
- *Constants*: numbers of modules in capitals, and those whose note names neither a source nor a
  script.
- *Lines* of source by folder, and files in it.
"""

import ast
import re
from collections.abc import Iterator
from functools import cache
from itertools import zip_longest
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1] / "src" / "maidenflight"
CLOSURES = {
    "identify": "maidenflight.identification.identify",
    "train": "maidenflight.training.train",
    "export": "maidenflight.deployment",
}
"""By verb, the module of its function."""
WALKS = {
    "log to drone.toml": "maidenflight.verbs.identify:Identify.compute",
    "drone to policy": "maidenflight.verbs.train:Train.compute",
    "policy to flight": "maidenflight.verbs.transfer:Transfer.compute",
    "policy to C": "maidenflight.deployment.c:export_c",
    "study to table": "maidenflight.studies.sweeping:sweep",
}
SOURCE = re.compile(
    r"sources?\b|et al|firmware|data ?sheet|manual|standard|specification|https?:|paper|notes/"
    r"|benchmarks/|\.py\b|\.[ch]\b|page \d|sec\.|eq:|chosen|measured|by definition|ours\b",
    re.IGNORECASE,
)
"""What a constant's note names where its number has a source or a script that finds it again."""


class Module(NamedTuple):
    """A module of ours."""

    tree: ast.Module
    definitions: dict[str, ast.AST]
    """Functions, classes and `Class.method`."""
    imports: dict[str, str]
    """Names that it imports, at its top or inside a function, by what they stand for."""


@cache
def modules() -> dict[str, Module]:
    """Reads all modules, by their dotted names."""
    read = {}
    for path in sorted(ROOT.rglob("*.py")):
        parts = ("maidenflight", *path.relative_to(ROOT).with_suffix("").parts)
        tree, definitions = ast.parse(path.read_text()), dict[str, ast.AST]()
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                definitions[node.name] = node
            if isinstance(node, ast.ClassDef):
                for inner in node.body:
                    if isinstance(inner, ast.FunctionDef):
                        definitions[f"{node.name}.{inner.name}"] = inner
        imports = {}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom):
                for one in node.names:
                    imports[one.asname or one.name] = f"{node.module}.{one.name}"
            elif isinstance(node, ast.Import):
                for one in node.names:
                    imports[one.asname or one.name.partition(".")[0]] = one.name
        read[".".join(parts).removesuffix(".__init__")] = Module(tree, definitions, imports)
    return read


def module_of(target: str) -> str:
    """Returns the module of ours that a dotted name lies in; nothing of others' names."""
    while target not in modules() and "." in target:
        target = target.rpartition(".")[0]
    return target if target in modules() else ""


def imported(name: str) -> set[str]:
    """Returns the modules of ours that a module imports."""
    return {module_of(target) for target in modules()[name].imports.values()} - {"", name}


def closure(start: str) -> set[str]:
    """Returns the modules that a module needs, itself included."""
    reached, waiting = set[str](), [start]
    while waiting:
        name = waiting.pop()
        if name not in reached:
            reached.add(name)
            waiting += imported(name)
    return reached


def resolve(module: str, owner: str, name: str) -> tuple[str, str] | None:
    """Returns module and definition of a dotted name in the code of a module; None of others'."""
    first, _, rest = name.partition(".")
    own = modules()[module]
    if first == "self" and owner:
        method = f"{owner}.{rest.partition('.')[0]}"
        return (module, method) if method in own.definitions else None
    if first in own.definitions:
        inner = f"{first}.{rest.partition('.')[0]}"
        return module, inner if inner in own.definitions else first
    if first not in own.imports:
        return None
    target = own.imports[first] + (f".{rest}" if rest else "")
    place = module_of(target)
    if not place:
        return None
    names = target.removeprefix(place).strip(".").split(".")
    other = modules()[place]
    for parts in (names[:2], names[:1]):
        if ".".join(parts) in other.definitions:
            return place, ".".join(parts)
    # A package that hands on what a module of it defines.
    if names[0] in other.imports and module_of(other.imports[names[0]]) != place:
        return resolve(place, "", ".".join(names))
    return None


def called(module: str, definition: str) -> Iterator[tuple[str, str]]:
    """Yields the definitions of ours that a definition names."""
    node, owner = modules()[module].definitions[definition], definition.partition(".")[0]
    if isinstance(node, ast.ClassDef):
        for name in ("__init__", "__post_init__", "__call__"):
            if f"{definition}.{name}" in modules()[module].definitions:
                yield module, f"{definition}.{name}"
        return
    has_owner = "." in definition
    for inner in ast.walk(node):
        if isinstance(inner, ast.Name | ast.Attribute) and isinstance(inner.ctx, ast.Load):
            try:
                name = ast.unparse(inner)
            except ValueError:
                continue
            if re.fullmatch(r"[\w.]+", name):
                place = resolve(module, owner if has_owner else "", name)
                if place is not None:
                    yield place


class Walk(NamedTuple):
    """What somebody meets who follows a stage from its entry on."""

    stops: int
    modules: int
    names: int


def walk(entry: str) -> Walk:
    """Counts what an entry, `MODULE:NAME`, leads to."""
    module, _, definition = entry.partition(":")
    reached, waiting = set[tuple[str, str]](), [(module, definition)]
    while waiting:
        place = waiting.pop()
        if place not in reached:
            reached.add(place)
            waiting += called(*place)
    names = set[str]()
    for module, definition in reached:
        node = modules()[module].definitions[definition]
        names.add(definition.rpartition(".")[2])
        if isinstance(node, ast.FunctionDef):
            every = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
            names |= {argument.arg for argument in every}
    return Walk(len(reached), len({module for module, _ in reached}), len(names))


def constants() -> tuple[int, list[str]]:
    """Returns how many constants hold numbers, and which of them name no source."""
    total, unsourced = 0, []
    for name, module in modules().items():
        for node, following in zip_longest(module.tree.body, module.tree.body[1:]):
            if isinstance(node, ast.Assign):
                target = node.targets[0]
            elif isinstance(node, ast.AnnAssign):
                target = node.target
            else:
                continue
            if not re.fullmatch(r"[A-Z_0-9, ()]+", ast.unparse(target)):
                continue
            numbers = [
                one.value
                for one in ast.walk(node.value or node)
                if isinstance(one, ast.Constant) and isinstance(one.value, int | float)
            ]
            if not any(abs(number) not in (0, 1, 2) for number in numbers):
                continue
            total += 1
            note = ast.unparse(following) if isinstance(following, ast.Expr) else ""
            comment = comment_above(name, node.lineno)
            if not SOURCE.search(note + comment):
                unsourced.append(f"{name}: {ast.unparse(target)}")
    return total, unsourced


@cache
def source_lines(name: str) -> list[str]:
    """Returns the lines of a module."""
    place = ROOT.parent / name.replace(".", "/")
    path = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
    return path.read_text().split("\n")


def comment_above(name: str, line: int) -> str:
    """Returns the comment above and behind a line of a module."""
    lines, above = source_lines(name), line - 2
    while above >= 0 and lines[above].lstrip().startswith("#"):
        above -= 1
    return "\n".join([*lines[above + 1 : line - 1], lines[line - 1].partition("#")[2]])


def folders() -> dict[str, tuple[int, int]]:
    """Returns files and lines of source by folder."""
    counts: dict[str, tuple[int, int]] = {}
    for path in sorted(ROOT.rglob("*.py")):
        folder = str(path.parent.relative_to(ROOT))
        files, lines = counts.get(folder, (0, 0))
        counts[folder] = files + 1, lines + path.read_text().count("\n")
    return counts


def count_all() -> dict[str, int]:
    """Returns every count by its name."""
    counts = {f"closure of {verb}": len(closure(name)) for verb, name in CLOSURES.items()}
    for name, entry in WALKS.items():
        counts |= {f"{name}: {what}": n for what, n in walk(entry)._asdict().items()}
    total, unsourced = constants()
    counts |= {"constants": total, "constants without a source": len(unsourced)}
    counts["lines"] = sum(lines for _, lines in folders().values())
    return counts


def main() -> None:
    """Prints all counts, and the folders from the largest on."""
    for name, count in count_all().items():
        print(f"{count:7,}  {name}")
    print("\n  lines  files  folder")
    for folder, (files, lines) in sorted(folders().items(), key=lambda one: -one[1][1]):
        if lines:
            print(f"{lines:7,}  {files:5}  {folder}")


if __name__ == "__main__":
    main()
