"""A few hundred damaged files for everything that reads files; benchmarks/fuzz.py reads 100,000."""

import importlib
import random
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from maidenflight import inputs
from maidenflight.errors import LONGEST, InputError

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
if str(BENCHMARKS) not in sys.path:
    sys.path.append(str(BENCHMARKS))
fuzz, fuzz_damage, fuzz_trees = map(importlib.import_module, ("fuzz", "fuzz_damage", "fuzz_trees"))
NAMES = sorted(fuzz.known_readers())


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_damaged_files_are_refused_or_mean_what_they_meant(name: str) -> None:
    reader = fuzz.known_readers()[name]
    with fuzz.laid(reader) as folder:
        for number in range(6 if "page" in name or "posterior" in name else 20):
            step_result, fault, _ = fuzz.tried(reader, number, 5, folder)
            assert step_result in ("accepted", "refused"), f"input {number}: {fault}"


@pytest.mark.parametrize("name", NAMES)
def test_good_files_are_accepted_and_sound(name: str) -> None:
    reader = fuzz.known_readers()[name]
    for number, good in enumerate(reader.good):
        assert reader.unsound(fuzz._good(reader, good.place, number)) == ""


@pytest.mark.parametrize("what", fuzz_damage.SPECIAL)
@pytest.mark.parametrize(
    "name",
    [
        "policy, JSON",
        "checkpoint",
        "flight log, ours",
        "way-points, CSV",
        "study, TOML",
    ],
)
def test_what_is_no_file_is_refused_and_not_waited_for(
    name: str, what: str, monkeypatch: Any
) -> None:
    reader = fuzz.known_readers()[name]
    verdict = fuzz_damage.SAME if what == "link to the file" else fuzz_damage.REFUSED
    monkeypatch.setattr(
        fuzz, "drawn", lambda *_: (reader.good[0], fuzz_damage.Damaged(None, what, verdict))
    )
    monkeypatch.setattr(fuzz, "LONGEST", 60.0)  # A busy machine is slow; a pipe waits for ever.
    with fuzz.laid(reader) as folder:
        step_result, fault, _ = fuzz.tried(reader, 0, 0, folder)
    assert step_result == ("accepted" if what == "link to the file" else "refused"), fault


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_reader_that_fails_waits_or_believes_all_is_noticed(monkeypatch: Any) -> None:
    # What is interrupted while a file is open leaves it to the garbage collector, which warns.
    reader = fuzz.known_readers()["policy, JSON"]
    monkeypatch.setattr(fuzz, "SPECIAL", 0.0)
    good = reader.read

    def waits(folder: Path, path: Path) -> Any:
        while True:
            good(folder, path)

    def drops(folder: Path, path: Path) -> Any:
        """Loses what is raised in it once, as a callback of the garbage collector does."""
        with suppress(fuzz.Late):
            waits(folder, path)
        waits(folder, path)

    def believes(folder: Path, path: Path) -> Any:
        try:
            return good(folder, path)
        except InputError:
            return fuzz._good(reader, "policy.json", 0)

    # Once before: what it compiles may take longer than a reader may.
    assert reader.unsound(fuzz._good(reader, "policy.json", 0)) == ""
    whole = fuzz_damage.Damaged(reader.good[0].content, "x", "any")
    cut = fuzz_damage.Damaged(b"{}", "x", fuzz_damage.REFUSED)
    cases = [
        ("crashes", lambda *_: 1 / 0, cut),
        ("hangs", waits, whole),
        ("hangs", drops, whole),
        ("silent", believes, cut),
    ]
    with fuzz.laid(reader) as folder:
        for expected, read, damaged in cases:
            wrong = reader._replace(read=read)
            monkeypatch.setattr(fuzz, "LONGEST", 0.05 if expected == "hangs" else 60.0)
            monkeypatch.setattr(
                fuzz, "drawn", lambda *_, damaged=damaged: (reader.good[0], damaged)
            )
            assert fuzz.tried(wrong, 0, 0, folder)[0] == expected


def test_an_input_is_the_same_every_time() -> None:
    reader = fuzz.known_readers()["flight log, ours"]
    assert fuzz.drawn(reader, 0, 17) == fuzz.drawn(reader, 0, 17)
    assert fuzz.drawn(reader, 0, 17) != fuzz.drawn(reader, 1, 17)
    generator = random.Random(0)
    tree = {"a": {"b": [1.0, 2.0]}, "c": 3}
    assert all(
        fuzz_trees.of_tree(generator, tree, lambda _: True, "json").content for _ in range(50)
    )
    assert tree == {"a": {"b": [1.0, 2.0]}, "c": 3}


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('{"a": 1, "a": 2}', "'a'"),
        ('[{"b": {"c": 1, "c": 1}}]', "'c'"),
        ("[" * 100_000, "too deep"),
    ],
    ids=["twice", "twice below", "deep"],
)
def test_json_says_everything_once_and_ends(text: str, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        inputs.from_json(text)


def test_an_error_is_one_line_of_bounded_length() -> None:
    said = str(InputError("here: " + "x\n" * 10_000 + "Mend it."))
    assert "\n" not in said
    assert len(said) <= LONGEST
    assert said.startswith("here: x")
    assert said.endswith("Mend it.")
