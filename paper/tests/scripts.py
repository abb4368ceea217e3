"""Scripts of the paper as modules."""

import importlib.util
from pathlib import Path
from typing import Any

import pytest

PAPER = Path(__file__).parents[1]


def script(name: str) -> Any:
    """A script of that folder as a module; as where it is run, its neighbours can be imported."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(PAPER))
        specification = importlib.util.spec_from_file_location(name, PAPER / f"{name}.py")
        assert specification is not None
        assert specification.loader is not None
        module = importlib.util.module_from_spec(specification)
        specification.loader.exec_module(module)
    return module
