"""Time as the program that flies sees it; tests give their own."""

import time
from typing import Protocol


class Clock(Protocol):
    """Tells the time and waits."""

    def now(self) -> float:
        """Returns the time [s], never backwards."""
        ...

    def sleep(self, seconds: float) -> None:
        """Waits for some seconds."""
        ...


class WallClock:
    """The computer's own."""

    def now(self) -> float:
        """Returns the time [s]."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Waits for some seconds."""
        time.sleep(max(seconds, 0.0))
