"""Values of settings, as words of a command line and as typed values, are the same."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from maidenflight import settings
from maidenflight.errors import InputError
from maidenflight.settings import PENDING, REQUIRED, Setting, Values

NAMES = st.sampled_from(("circle", "hover", "take_off"))
NUMBERS = st.floats(-1e3, 1e3)
WORDS = st.text("abcxyz_.", min_size=1, max_size=8)


def both(values: Values, word: str, typed: Any) -> Any:
    """What the verb sees, given a word, which is what it sees given the typed value."""
    read = values.parse(word)
    seen = values.check([read] if values.repeats else read)
    assert seen == values.check(typed)
    return seen


@given(st.integers(-50, 50), st.integers(-50, 50), st.integers(-200, 200))
def test_whole_numbers_are_taken_within_their_ends(one: int, other: int, number: int) -> None:
    low, high = sorted((one, other))
    values = settings.whole(low, high)
    assert values.accepts(number) == (low <= number <= high)
    assert not values.accepts(float(number))
    assert not values.accepts(True)
    if values.accepts(number):
        assert both(values, str(number), number) == number


@given(NUMBERS)
def test_numbers_become_floats_and_none_is_not_a_number(number: float) -> None:
    values = settings.number(-1e3, 1e3)
    assert type(both(values, repr(number), number)) is float
    assert type(values.check(3)) is float
    for wrong in (float("nan"), float("inf"), 1001, "3", True, None):
        assert not values.accepts(wrong)


@given(NAMES, NUMBERS)
def test_a_word_or_another_value_is_taken(word: str, number: float) -> None:
    values = settings.either(settings.number(-1e3, 1e3), "circle", "hover", "take_off")
    assert both(values, word, word) == word
    assert both(values, repr(number), number) == number
    with pytest.raises(ValueError):
        values.check("elsewhere")


@given(st.lists(st.integers(1, 99), min_size=1, max_size=5))
def test_a_list_is_one_word_with_separators(numbers: list[int]) -> None:
    values = settings.listed(settings.whole(1, 99), "sizes", "SIZES")
    assert both(values, ",".join(map(str, numbers)), numbers) == tuple(numbers)
    assert values.check(tuple(numbers)) == tuple(numbers)
    with pytest.raises(ValueError):
        values.check([])
    with pytest.raises(ValueError):
        values.parse("50,,50")


@given(st.dictionaries(WORDS, NUMBERS, max_size=4))
def test_a_table_is_name_and_value_repeated(content: dict[str, float]) -> None:
    values = settings.table(settings.number(-1e3, 1e3), "numbers by name")
    read = [values.parse(f"{name}={value!r}") for name, value in content.items()]
    assert values.check(read) == values.check(content) == content
    for word in ("latency", "=3", "latency=much"):
        with pytest.raises(ValueError):
            values.parse(word)


def test_paths_names_and_flags() -> None:
    assert both(settings.path(), "a/b.toml", "a/b.toml") == Path("a/b.toml")
    assert both(settings.choice("a", "b"), "b", "b") == "b"
    assert both(settings.several(settings.choice("a", "b")), "b", ["b"]) == ("b",)
    assert not settings.choice("a", "b").accepts("c")
    assert not settings.text().accepts("")
    assert settings.flag().accepts(False)
    assert not settings.flag().accepts(0)


def test_a_setting_names_its_place_the_value_and_what_is_expected() -> None:
    one = Setting(settings.whole(1, 9), 3, "How many.")
    assert one.check(4, "study: task 1: policies") == 4
    with pytest.raises(InputError, match=r"policies = '0'; expected a whole number from 1 to 9"):
        one.check(0, "study: task 1: policies")
    with pytest.raises(InputError, match="policies is missing"):
        Setting(settings.whole(1, 9), REQUIRED, "").check(REQUIRED, "policies")
    assert one.check(PENDING, "policies") is PENDING
    assert Setting(settings.whole(1, 9), None, "").check(None, "policies") is None
    with pytest.raises(InputError):
        one.check(None, "policies")


def test_values_become_plain_for_records_and_studies() -> None:
    value = {"a": (Path("x/y"), 1.5), "b": [True, None], "c": float("inf")}
    assert settings.plain(value) == {"a": ["x/y", 1.5], "b": [True, None], "c": None}


def test_no_truth_value_passes_for_a_number_that_equals_it() -> None:
    one = Setting(settings.whole(0, 10), 0, "")
    assert one.check(0, "seed") == 0
    with pytest.raises(InputError, match="seed"):
        one.check(False, "seed")
