"""Output of how far an identification is."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

from maidenflight import terminal

if TYPE_CHECKING:
    from maidenflight.identification.information import Expected
    from maidenflight.identification.progress import Progress

READING = "reading flights"
SHARES = {
    READING: 1.0,
    "motor lag": 4.0,
    "what flights can tell": 2.0,
    "choosing parameters": 8.0,
    "fitting": 5.0,
    "intervals": 2.0,
}
"""How long each stage takes beside the others: four minutes of flight with an accelerometer."""
_OF = {"motor lag": "flights", "choosing parameters": "groups"}


def remark(now: "Progress") -> str:
    """A stage in words."""
    parts = [now.stage]
    if now.of and now.stage in _OF:
        parts.append(f"{now.done} of {now.of} {_OF[now.stage]}")
    if now.gain is not None:
        parts.append(f"{now.gain.group} {'kept' if now.gain.kept else 'not kept'}")
    if now.evaluations:
        parts.append(f"evaluation {now.evaluations}")
    return ", ".join(parts)


@contextmanager
def identification(
    on_expected: Callable[["Mapping[str, Expected]"], None],
) -> Iterator[tuple[Callable[[int, int], None], Callable[["Progress"], None]]]:
    """A progress bar for an identification: what to call for each file, and for its progress.

    Args:
        on_expected: called with what the flights can tell, before anything is fitted.
    """
    with terminal.staged("identify", SHARES) as move:

        def told(now: "Progress") -> None:
            move(now.stage, now.done, now.of, remark(now))
            if now.expected is not None:
                on_expected(now.expected)

        yield lambda done, of: move(READING, done, of, f"{READING}, {done} of {of}"), told
