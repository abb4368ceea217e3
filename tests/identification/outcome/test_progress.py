"""How far an identification is moves on and never back."""

from hypothesis import given
from hypothesis import strategies as st

from maidenflight.identification.drone_file import GroupGain
from maidenflight.identification.likelihood.information import ExpectedInterval
from maidenflight.identification.outcome.progress import (
    CHOICE,
    EXPECTING,
    INTERVALS,
    READING,
    SHARES,
    STAGES,
    Overall,
    Progress,
    describe,
)

EXPECTED = {
    "latency": ExpectedInterval((0.0, 0.03), (0.0, 0.02), True),
    "drag_x": ExpectedInterval((0.0, 0.5), (0.0, 0.5), False),
}
CALLS = st.tuples(st.sampled_from(list(SHARES)), st.integers(0, 9), st.integers(0, 5))


@given(st.lists(CALLS))
def test_the_share_that_is_done_never_falls_and_ends_at_one(
    calls: list[tuple[str, int, int]],
) -> None:
    overall = Overall()
    shares = [
        overall.read(done, of)[0]
        if stage == READING
        else overall.reach(Progress(stage, done, of, 3))[0]
        for stage, done, of in calls
    ]
    shares.append(overall.reach(Progress(EXPECTING, 1, 1, 0, EXPECTED))[0])
    shares.append(overall.reach(Progress(INTERVALS, 2, 2, 3))[0])
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_what_flights_cannot_tell_is_named() -> None:
    assert Progress(EXPECTING, 1, 1, 0, EXPECTED).unidentifiable == ["drag_x"]
    assert Progress(EXPECTING, 1, 1, 0).unidentifiable == []


def test_every_stage_of_an_identification_is_known_and_described() -> None:
    assert list(SHARES) == [READING, *STAGES]
    gain = GroupGain("drag", 0.1, 0.01, True)
    for now, words in (
        (Progress(CHOICE, 3, 8, 20, None, gain), ("3 of 8", "drag")),
        (Progress(INTERVALS, 0, 2, 41), (INTERVALS, "41")),
    ):
        assert all(word in describe(now) for word in words)
