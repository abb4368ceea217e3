"""Scripts of benchmarks and the paper ask for what they need before they begin."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

from maidenflight import errors

ROOT = Path(__file__).parents[2]
PAPER = {*ROOT.glob("paper/**/*.py")} - {*ROOT.glob("paper/tests/*.py")}
SCRIPTS = sorted([*ROOT.glob("benchmarks/*.py"), *PAPER])
OPTIONAL = {*errors._EXTRAS, "ray", "crazyflow", "l2f", "pybullet", "h5py", "onnx", "onnxruntime"}
ELSEWHERE = {"crazyflow_speed.py", "maidenflight_speed.py", "notes_in_site.py"}
"""What other scripts start in an environment that they made or asked for."""


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_optional_packages_are_asked_for_first(path: Path) -> None:
    tree = ast.parse(path.read_text())
    imported = {
        name.partition(".")[0]
        for node in ast.walk(tree)
        for name in (
            [alias.name for alias in node.names]
            if isinstance(node, ast.Import)
            else [node.module or ""]
            if isinstance(node, ast.ImportFrom)
            else []
        )
    }
    needed = imported & OPTIONAL
    asked = {
        argument.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "require_packages"
        for argument in ast.walk(node)
        if isinstance(argument, ast.Constant)
    }
    assert needed <= asked or path.name in ELSEWHERE


HIDE = (
    "import sys, runpy; sys.modules[{0!r}] = None; sys.argv = {1!r}; "
    "runpy.run_path({2!r}, run_name='__main__')"
)


@pytest.mark.parametrize(
    ("script", "words", "package", "extra"),
    [
        ("benchmarks/simulator.py", [], "gymnasium", "gym"),
        *(
            pytest.param(*one, marks=pytest.mark.slow)
            for one in (
                ("benchmarks/gallery.py", ["."], "PIL", "gym"),
                ("benchmarks/checkup.py", ["--data", "."], "pyulog", "ulog"),
                (
                    "paper/measured/other_simulators.py",
                    ["--reality", "l2f:crazyflie"],
                    "l2f",
                    "l2f",
                ),
            )
        ),
    ],
)
def test_what_lacks_is_said_before_anything_is_done(
    script: str, words: list[str], package: str, extra: str, tmp_path: Path
) -> None:
    path = ROOT / script
    code = HIDE.format(package, [script, *words], str(path))
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(path.parent)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1, done.stderr
    assert done.stderr.strip().splitlines() == [f"Needs {package}: pip install -e '.[{extra}]'"], (
        done.stderr
    )
    assert list(tmp_path.iterdir()) == []
