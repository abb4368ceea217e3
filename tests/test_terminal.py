"""Progress bars: they move on and never back, and their clock counts."""

import itertools
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from maidenflight import terminal
from maidenflight.identification.drone_file import GroupGain
from maidenflight.identification.information import Expected
from maidenflight.identification.progress import CHOICE, EXPECTING, INTERVALS, STAGES, Progress
from maidenflight.terminal import progress_output

EXPECTED = {"latency": Expected((0.0, 0.03), (0.0, 0.02), True)}
CALLS = st.tuples(
    st.sampled_from(list(progress_output.SHARES)), st.integers(0, 9), st.integers(0, 5)
)


@given(st.lists(CALLS))
def test_a_bar_over_stages_never_moves_back_and_ends_full(
    calls: list[tuple[str, int, int]],
) -> None:
    moves: list[tuple[int, int, str]] = []
    said: list[Any] = []

    @contextmanager
    def recorded(*_: Any, **__: Any) -> Iterator[Any]:
        yield lambda *move: moves.append(move)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(terminal, "progress", recorded)
        with progress_output.identification(said.append) as (on_file, on_progress):
            for stage, done, of in calls:
                if stage == progress_output.READING:
                    on_file(done, of)
                else:
                    on_progress(Progress(stage, done, of, 3))
            on_progress(Progress(EXPECTING, 1, 1, 0, EXPECTED))
            on_progress(Progress(INTERVALS, 2, 2, 3))
    assert said == [EXPECTED]
    reached = [done for done, _, _ in moves]
    assert reached == sorted(reached)
    assert moves[-1][0] == moves[-1][1]


def test_a_bar_knows_every_stage_of_an_identification() -> None:
    assert list(progress_output.SHARES) == [progress_output.READING, *STAGES]
    gain = GroupGain("drag", 0.1, 0.01, True)
    for now, words in (
        (Progress(CHOICE, 3, 8, 20, None, gain), ("3 of 8", "drag")),
        (Progress(INTERVALS, 0, 2, 41), (INTERVALS, "41")),
    ):
        assert all(word in progress_output.remark(now) for word in words)


def test_the_clock_of_a_bar_counts_on_when_its_total_becomes_unknown(
    monkeypatch: Any, capsys: Any
) -> None:
    clock = itertools.count(0, 7)
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setattr("rich.console.monotonic", lambda: next(clock))
    with terminal.progress("try", 10, remaining=False) as move:
        move(5, 10, "half")
        move(0, None, "unknown")
        move(1, 2, "half again")
    shown = re.findall(r"\d:\d\d:\d\d", capsys.readouterr().err)
    assert shown == sorted(shown)
    assert shown[-1] > "0:00:07"
