"""maidenflight: from flight logs to a neural network that flies the real drone on its first try."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"
