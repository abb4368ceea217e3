"""maidenflight: from flight logs of a quadrotor to a neural network that is to fly it.

The public names stand in `__init__.pyi`, each with its module, which is imported when the name is
first used: `import maidenflight` does not import JAX.
"""

from difflib import get_close_matches
from typing import Any

import lazy_loader

__version__ = "0.2.0"

_attribute, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ += ["__version__"]


def __getattr__(name: str) -> Any:
    """Imports a public name; of one that is none, the error names what it resembles."""
    try:
        return _attribute(name)
    except AttributeError as error:
        similar = get_close_matches(name, __all__, 1)
        if name.startswith("_") or not similar:
            raise
        raise AttributeError(f"{error}. Did you mean {similar[0]}?", name=name) from None
