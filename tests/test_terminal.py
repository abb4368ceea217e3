"""Progress bars: they move on and never back, and their clock counts."""

import itertools
import re
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from maidenflight.identification.drone_file import GroupGain
from maidenflight.identification.outcome.plausible import Expected
from maidenflight.identification.outcome.progress import (
    CHOICE,
    EXPECTING,
    INTERVALS,
    STAGES,
    Progress,
)
from maidenflight.terminal import Bar
from maidenflight.verb import Progress as Shown
from maidenflight.verbs import identify
from maidenflight.verbs.identify import SHARES, describe_stage

EXPECTED = {
    "latency": Expected((0.0, 0.03), (0.0, 0.02), True),
    "drag_x": Expected((0.0, 0.5), (0.0, 0.5), False),
}
READING = next(iter(SHARES))
CALLS = st.tuples(st.sampled_from(list(SHARES)), st.integers(0, 9), st.integers(0, 5))


class Heard(Shown):
    """Keeps what a bar is told."""

    def __init__(self) -> None:
        self.moves: list[tuple[int, int | None, str]] = []
        self.said: list[str] = []

    def move(self, done: int, total: int | None, remark: str = "") -> None:
        self.moves.append((done, total, remark))

    def note(self, text: str) -> None:
        self.said.append(text)


@given(st.lists(CALLS))
def test_a_bar_over_stages_never_moves_back_and_ends_full(
    calls: list[tuple[str, int, int]],
) -> None:
    heard = Heard()
    stages = identify._Stages(heard)
    for stage, done, of in calls:
        if stage == READING:
            stages.on_file(done, of)
        else:
            stages.on_progress(Progress(stage, done, of, 3))
    stages.on_progress(Progress(EXPECTING, 1, 1, 0, EXPECTED))
    stages.on_progress(Progress(INTERVALS, 2, 2, 3))
    assert heard.said == ["these flights cannot tell drag_x; plausible ranges are kept"]
    reached = [done for done, _, _ in heard.moves]
    assert reached == sorted(reached)
    assert heard.moves[-1][0] == heard.moves[-1][1]


def test_a_bar_knows_every_stage_of_an_identification() -> None:
    assert list(SHARES) == [READING, *STAGES]
    gain = GroupGain("drag", 0.1, 0.01, True)
    for now, words in (
        (Progress(CHOICE, 3, 8, 20, None, gain), ("3 of 8", "drag")),
        (Progress(INTERVALS, 0, 2, 41), (INTERVALS, "41")),
    ):
        assert all(word in describe_stage(now) for word in words)


def test_the_clock_of_a_bar_counts_on_when_its_total_becomes_unknown(
    monkeypatch: Any, capsys: Any
) -> None:
    clock = itertools.count(0, 7)
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setattr("rich.console.monotonic", lambda: next(clock))
    with Bar("try", remaining=False) as bar:
        bar.move(5, 10, "half")
        bar.move(0, None, "unknown")
        bar.move(1, 2, "half again")
    shown = re.findall(r"\d:\d\d:\d\d", capsys.readouterr().err)
    assert shown == sorted(shown)
    assert shown[-1] > "0:00:07"
