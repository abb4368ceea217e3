"""Imports run one way: each stage knows only the stages before it."""

import ast
from pathlib import Path

import pytest

import maidenflight

ROOT = Path(maidenflight.__file__).parent
ORDER = [
    "parameters",
    "simulator gru",
    "flights gym policy",
    "flying",
    "foreign",
    "policy_file",
    "identification training",
    "experiments",
    "deployment reporting link",
    "plant",
    "verb",
    "studies terminal",
    "verbs",
    "cli",
]
RANK = {name: rank for rank, names in enumerate(ORDER) for name in names.split()}
FREE = set("cache compiler cores errors inputs manifest names results run_folder settings".split())
"""May be imported by all, and import no stage."""
APART = {"identification", "training", "deployment"}
"""Never import each other, whatever their rank."""


def imported(source: str) -> set[str]:
    """The parts of maidenflight that a module imports, at its top or inside a function."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    parts = [name.split(".") for name in names]
    return {part[1] for part in parts if part[0] == "maidenflight" and len(part) > 1} - {
        "__version__"
    }


def forbidden(importer: str, target: str) -> bool:
    if importer == target or target in FREE:
        return importer == "errors" and target != "errors"
    return importer in FREE or {importer, target} <= APART or RANK[target] >= RANK[importer]


MODULES = [
    path.relative_to(ROOT)
    for path in sorted(ROOT.rglob("*.py"))
    if path.parent != ROOT or not path.name.startswith("__")
]


@pytest.mark.parametrize("module", MODULES, ids=str)
def test_a_module_imports_only_earlier_stages(module):
    importer = module.parts[0].removesuffix(".py")
    assert importer in RANK.keys() | FREE, f"{importer} has no place in the order of the stages"
    wrong = [
        target for target in imported((ROOT / module).read_text()) if forbidden(importer, target)
    ]
    assert not wrong, f"{module} imports {wrong}"


@pytest.mark.parametrize(
    ("importer", "source"),
    [
        ("parameters", "from maidenflight.simulator import dynamics"),
        ("simulator", "from maidenflight import policy"),
        ("training", "def f():\n    import maidenflight.identification.identify"),
        ("deployment", "from maidenflight.training import ppo"),
        ("studies", "from maidenflight.verbs.train import Train"),
        ("verbs", "def f():\n    from maidenflight import cli"),
        ("results", "from maidenflight.parameters import Parameters"),
    ],
)
def test_an_import_against_the_order_is_noticed(importer, source):
    assert any(forbidden(importer, target) for target in imported(source))
