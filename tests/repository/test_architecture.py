"""Imports run one way: each stage knows only the stages before it, and none the integrations."""

import ast
import importlib
import re
import sys
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any

import pytest

import maidenflight
from maidenflight import registry as registries

ROOT = Path(maidenflight.__file__).parent
ORDER = [
    "parameters",
    "simulator",
    "flights policy",
    "flying",
    "policy_file",
    "identification training disturbances",
    "experiments",
    "deployment reporting",
    "terminal",
    "verb",
    "studies",
    "verbs",
    "cli",
    "integrations",
]
RANK = {name: rank for rank, names in enumerate(ORDER) for name in names.split()}
FREE = set(
    "budget cache compiler errors events inputs manifest names registry results run_folder "
    "settings".split()
)
"""May be imported by all, and import no stage."""
APART = {"identification", "training", "deployment"}
"""Never import each other, whatever their rank."""


@cache
def imported_names(source: str) -> set[str]:
    """What a module imports, at its top or inside a function."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def imported(source: str) -> set[str]:
    """The parts of maidenflight that a module imports."""
    parts = [name.split(".") for name in imported_names(source)]
    return {part[1] for part in parts if part[0] == "maidenflight" and len(part) > 1} - {
        "__version__"
    }


def forbidden(importer: str, target: str) -> bool:
    if importer == target or target in FREE:
        return importer == "errors" and target != "errors"
    return importer in FREE or {importer, target} <= APART or RANK[target] >= RANK[importer]


REGISTRIES = [one for one in vars(registries).values() if isinstance(one, registries.Registry)]
MODULES = [
    path.relative_to(ROOT)
    for path in sorted(ROOT.rglob("*.py"))
    if path.parent != ROOT or not path.name.startswith("__")
]


@cache
def parsed(module: Path) -> ast.Module:
    return ast.parse((ROOT / module).read_text())


def test_modules_import_only_earlier_stages():
    for module in MODULES:
        importer = module.parts[0].removesuffix(".py")
        assert importer in RANK.keys() | FREE, f"{importer} has no place in the order of stages"
        targets = imported((ROOT / module).read_text())
        wrong = [target for target in targets if forbidden(importer, target)]
        assert not wrong, f"{module} imports {wrong}"


MOST_ARGUMENTS, MOST_LINES, MOST_LINES_OF_FILE = 8, 100, 400
BEYOND = {"predict_flight_times", "train"}
"""Functions that take more: each of its settings is one that callers change alone."""


def test_files_and_functions_are_short_and_take_few_arguments():
    for module in MODULES:
        assert (ROOT / module).read_text().count("\n") <= MOST_LINES_OF_FILE, module
        for node in ast.walk(parsed(module)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                taken = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
                names = [one.arg for one in taken if one.arg not in ("self", "cls")]
                place = f"{module}: {node.name}"
                assert len(names) <= MOST_ARGUMENTS or node.name in BEYOND, place
                assert (node.end_lineno or 0) - node.lineno < MOST_LINES, place


PARTS = [
    "uncertainty unknowns",
    "posterior",
    "drone_file methods behaviour",
    "identity",
    "signals",
    "search",
    "outcome",
    "replay path_flights",
    "likelihood",
    "identify closed_loop held_out start truth calibration",
    "design",
]
PART = {name: rank for rank, names in enumerate(PARTS) for name in names.split()}
"""Of identification, in order."""


def test_parts_of_identification_import_only_earlier_parts():
    for module in (ROOT / "identification").rglob("[a-z]*.py"):
        part = module.relative_to(ROOT / "identification").parts[0].removesuffix(".py")
        pattern = r"maidenflight\.identification(?:\.| import )(\w+)"
        targets = set(re.findall(pattern, module.read_text())) - {part}
        assert all(PART[target] < PART[part] for target in targets), f"{module}: {targets}"


@pytest.mark.parametrize(
    ("importer", "source"),
    [
        ("parameters", "from maidenflight.simulator.physics import dynamics"),
        ("simulator", "from maidenflight import policy"),
        ("training", "def f():\n    import maidenflight.identification.identify"),
        ("deployment", "from maidenflight.training import ppo"),
        ("studies", "from maidenflight.verbs.train import Train"),
        ("verbs", "def f():\n    from maidenflight import cli"),
        ("flights", "from maidenflight.integrations.logs import px4"),
        ("cli", "def f():\n    import maidenflight.integrations.gym"),
        ("results", "from maidenflight.parameters import Parameters"),
    ],
)
def test_an_import_against_the_order_is_noticed(importer, source):
    assert any(forbidden(importer, target) for target in imported(source))


def module_name(path: Path) -> str:
    return ".".join(("maidenflight", *path.with_suffix("").parts)).removesuffix(".__init__")


def graph(sources: dict[str, str]) -> dict[str, set[str]]:
    """The modules that each module imports, at its top or inside a function."""
    found: dict[str, set[str]] = {}
    for name, source in sources.items():
        found[name] = set()
        for target in imported_names(source):
            while target not in sources and "." in target:
                target = target.rpartition(".")[0]
            found[name] |= {target} & sources.keys() - {name}
    return found


def circles(imports: dict[str, set[str]]) -> set[str]:
    """The modules that lie in a circle of imports, or behind one."""
    left = dict(imports)
    while free := [name for name, targets in left.items() if not targets & left.keys()]:
        for name in free:
            del left[name]
    return set(left)


def test_no_modules_import_each_other_in_a_circle():
    paths = [path.relative_to(ROOT) for path in ROOT.rglob("*.py")]
    sources = {module_name(path): (ROOT / path).read_text() for path in paths}
    assert not circles(graph(sources))


def test_a_circle_of_imports_is_noticed():
    sources = {
        "maidenflight.a": "from maidenflight.b import one",
        "maidenflight.b": "def f():\n    from maidenflight import c",
        "maidenflight.c": "import maidenflight.a",
        "maidenflight.d": "import maidenflight.errors",
    }
    assert circles(graph(sources)) == {f"maidenflight.{name}" for name in "abc"}


@pytest.mark.parametrize("registry", REGISTRIES, ids=lambda one: one.kind)
def test_what_a_registry_names_is_there(registry):
    for name, text in registry.own.items():
        module, _, attribute = text.partition(":")
        place = Path(*module.split(".")[1:])
        (path,) = {ROOT / place / "__init__.py", ROOT / f"{place}.py"} & set(ROOT.rglob("*.py"))
        names = [
            ast.unparse(node.targets[0]) if isinstance(node, ast.Assign) else node.name
            for node in ast.parse(path.read_text()).body
            if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.Assign)
        ]
        assert attribute in names, name


PARTICIPLES = set(
    "told untold asked said seen shown held heard found flown made kept given taken looked looks "
    "anew apart beside around lent meant bought".split()
)


def words_of(name: str) -> list[str]:
    return re.sub(r"([a-z])([A-Z])", r"\1_\2", name).lower().strip("_").split("_")


def defined_names(tree: ast.AST) -> list[str]:
    """Names of functions, classes, arguments and variables, as often as they are bound."""
    names = []
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names.append(node.name)
        elif isinstance(node, ast.arg):
            names.append(node.arg)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.append(node.id)
    return names


def test_names_are_nouns_or_verbs_with_their_objects():
    bare, compound = [], set()
    for module in MODULES:
        for name in defined_names(parsed(module)):
            words = words_of(name)
            if len(words) == 1 and words[0] in PARTICIPLES:
                bare.append(f"{module}: {name}")
            elif PARTICIPLES & set(words):
                compound.add(name)
    assert len(bare) <= 20, "\n".join(bare)
    assert len(compound) <= 12, sorted(compound)


def test_names_say_what_they_hold():
    hollow = [
        f"{module}: {name}"
        for module in MODULES
        for name in defined_names(parsed(module))
        if name in ("one", "place")
    ]
    assert not hollow


MOST_SHARED = 8
"""Names of functions and classes that more than three modules define; each is one to rename, unless
a registry or protocol asks for it."""


def test_few_names_are_defined_in_many_modules():
    modules: dict[str, list[str]] = {}
    for module in MODULES:
        for node in parsed(module).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                modules.setdefault(node.name, []).append(str(module))
    shared = {name: places for name, places in modules.items() if len(places) > 3}
    assert len(shared) <= MOST_SHARED, shared


def test_docstrings_of_functions_begin_with_a_verb():
    for module in MODULES:
        for node in ast.walk(parsed(module)):
            if not isinstance(node, ast.FunctionDef) or node.name.startswith("_"):
                continue
            text = ast.get_docstring(node)
            if text and not any("property" in ast.unparse(one) for one in node.decorator_list):
                first, place = text.partition("\n\n")[0], f"{module}: {node.name}"
                assert re.match(r"[A-Z][a-z]+s\b|See `\w+`\.", first), f"{place}: {first}"
                assert len(first) <= 100, f"{place}: {first}"


BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
if str(BENCHMARKS) not in sys.path:
    sys.path.append(str(BENCHMARKS))
parts: Any = importlib.import_module("parts")

MOST = {
    "closure of identify": 80,
    "closure of train": 55,
    "closure of export": 30,
    "log to drone.toml: stops": 740,
    "log to drone.toml: modules": 114,
    "log to drone.toml: names": 976,
    "drone to policy: stops": 390,
    "drone to policy: modules": 79,
    "drone to policy: names": 571,
    "policy to flight: stops": 273,
    "policy to flight: modules": 57,
    "policy to flight: names": 416,
    "policy to C: stops": 46,
    "policy to C: modules": 12,
    "policy to C: names": 73,
    "study to table: stops": 75,
    "study to table: modules": 14,
    "study to table: names": 122,
    "constants": 722,
    "constants without a source": 407,
    "lines": 62_606,
}
"""What benchmarks/parts.py may count. Lower a number with what it counts; whoever raises one says
why in the commit."""
MOST_FILES = 20
"""Modules in a folder."""


def test_what_one_has_to_hold_in_the_head_does_not_grow():
    counts = parts.count_all()
    assert counts.keys() == MOST.keys()
    grown = {name: (count, MOST[name]) for name, count in counts.items() if count > MOST[name]}
    assert not grown, "counted, allowed"
    assert not {name for name, (files, _) in parts.folders().items() if files > MOST_FILES}
    for root in ("tests", "paper"):
        files = Counter(path.parent.name for path in BENCHMARKS.with_name(root).rglob("*.py"))
        assert max(files.values()) <= MOST_FILES, files


def test_a_walk_follows_calls_methods_and_what_a_package_hands_on(tmp_path, monkeypatch):
    package = tmp_path / "maidenflight"
    package.mkdir()
    sources = {
        "a": "from maidenflight import b\nfrom maidenflight.c import C\n"
        "def start(x):\n    b.one(x)\n    return C(x)\n",
        "b": "import numpy\ndef one(y):\n    numpy.sum(y)\n    return one(y)\ndef unused(): ...\n",
        "c": "class C:\n    def __init__(self, x): self.two()\n    def two(self): ...\n"
        "GRAVITY = 9.81\nREACH = 0.3\n'Source: the data sheet.'\nTWO = 2\n",
    }
    for name, source in sources.items():
        (package / f"{name}.py").write_text(source)
    (package / "__init__.py").write_text("")
    monkeypatch.setattr(parts, "ROOT", package)
    for cached in (parts.modules, parts.source_lines):
        cached.cache_clear()
    try:
        walked = parts.walk("maidenflight.a:start")
        # start, one, C, __init__, two; of these and their arguments x, y and self.
        assert walked == (5, 3, 8)
        assert parts.closure("maidenflight.a") == {f"maidenflight.{name}" for name in "abc"}
        assert parts.constants() == (2, ["maidenflight.c: GRAVITY"])
    finally:
        for cached in (parts.modules, parts.source_lines):
            cached.cache_clear()
