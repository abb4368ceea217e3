"""Scripts of the paper as modules."""

import importlib.util
from pathlib import Path
from typing import Any

import pytest

PAPER = Path(__file__).parents[1]


def script(name: str) -> Any:
    """A script of that folder, or of one in it, as a module.

    As where it is run, its neighbours can be imported.
    """
    with pytest.MonkeyPatch.context() as patch:
        (path,) = PAPER.rglob(f"{name}.py")
        patch.syspath_prepend(str(path.parent))
        specification = importlib.util.spec_from_file_location(name, path)
        assert specification is not None
        assert specification.loader is not None
        module = importlib.util.module_from_spec(specification)
        specification.loader.exec_module(module)
    return module
