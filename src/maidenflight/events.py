"""What a command tells a program that listens: a JSON object a line, on standard output.

A program that sets `VARIABLE` in a command's environment reads its progress, notes, scores of
training and result instead of text.
"""

import json
import os
from typing import Any

VARIABLE = "MAIDENFLIGHT_EVENTS"
"""Variable of the environment; any text but an empty one."""


def listened_to() -> bool:
    """Returns whether a program listens."""
    return bool(os.environ.get(VARIABLE))


def tell(**event: Any) -> bool:
    """Writes an event where a program listens; returns whether one does."""
    if listened_to():
        print(json.dumps(event, default=str), flush=True)
        return True
    return False
