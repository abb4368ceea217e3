"""Output of flight logs: what was read of them."""

import sys
from typing import TYPE_CHECKING, Any

from maidenflight import terminal

if TYPE_CHECKING:
    from maidenflight.flights.reading import Flights


def content(flights: "Flights") -> dict[str, Any]:
    """What was read, for JSON."""
    return {
        "files": len(flights.paths),
        "pieces": len(flights),
        "seconds": round(flights.duration, 2),
        "dropped": flights.notes,
        "refused": flights.refused,
    }


def show(flights: "Flights", windows: int) -> None:
    """Prints what was read, and how many windows were cut of it."""
    print(
        f"{len(flights.paths)} files, {len(flights)} usable pieces of flight, "
        f"{flights.duration:.0f} s; {windows} windows of rows"
    )
    if flights.notes:
        terminal.notes(flights.notes)
    if flights.refused:
        print(f"{len(flights.refused)} files refused:", file=sys.stderr)
        for reason in flights.refused[:3]:
            print(f"  {reason}", file=sys.stderr)
        if len(flights.refused) > 3:
            print(f"  and {len(flights.refused) - 3} more; --json lists them all", file=sys.stderr)
