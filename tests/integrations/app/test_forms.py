"""Forms are derived: what a verb declares is what its form offers, without a line in the page."""

import re
from pathlib import Path

import click
import page_client  # noqa: F401, skips without the extra
import pytest
from page_client import opened

from maidenflight import cli
from maidenflight.cli.command import VerbCommand
from maidenflight.errors import InputError
from maidenflight.integrations.app import forms
from maidenflight.registry import VERBS
from maidenflight.settings import choice, flag, setting, several, text, whole
from maidenflight.terminal import Progress
from maidenflight.verb import Output, Result, Verb, find_verb

FORMS = list(forms.verbs())


class Survey(Verb):
    """Survey what is new."""

    output = Output(None, "Nothing.")

    place: str = setting(text("a place"), argument=True)
    pace: int = setting(whole(3, 7), 5, "A pace that nobody knew of.")
    colour: str = setting(choice("teal", "ochre"), "teal", "A colour.", rare=True)
    parts: tuple[str, ...] = setting(several(choice("wing", "arm"), empty=True), (), "Parts.")
    deep: bool = setting(flag(), False, "Look deeper.")
    trust: bool = setting(flag(), False, "Run what it names.", consent=True)

    def compute(self, output: Path | None, progress: Progress) -> Result:
        return Result()


@pytest.mark.parametrize("name", FORMS)
def test_a_form_has_every_setting_but_those_of_trust_and_safety(name: str) -> None:
    verb = find_verb(name)
    offered = forms.fields(verb)
    consent = {one for one, (_, declared) in verb.settings().items() if declared.consent}
    assert not consent & offered.keys()
    assert offered.keys() - {"output", "overwrite"} == verb.settings().keys() - consent
    known = {(one.name or "").rstrip("_") for one in VerbCommand(verb).params}
    assert offered.keys() <= known


def test_a_new_verb_with_new_options_appears_by_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(VERBS.own, "survey", Survey)
    with opened(tmp_path) as client:
        page = client.get("").text
        assert client.get("state").json()["steps"]["survey"]["state"] == ""
    (form,) = re.findall(r'<section id="survey".*?</section>', page, re.DOTALL)
    pace = re.search(r"<input[^>]*survey-pace[^>]*>", form)
    assert pace
    for part in ('min="3"', 'max="7"', "type=number", 'step="1"', 'placeholder="5"'):
        assert part in pace[0]
    assert "A pace that nobody knew of." in form
    assert form.index("survey-place") < form.index("Options") < form.index("survey-pace")
    assert form.index("More</summary>") < form.index("survey-colour")
    assert "<option>ochre</option>" in form
    assert form.count('name="parts"') == 2
    assert re.search(r'type=checkbox id="survey-deep"', form)
    assert "trust" not in form


@pytest.mark.parametrize("name", FORMS)
def test_what_a_form_holds_is_what_the_command_line_reads(name: str) -> None:
    verb = find_verb(name)
    filled: dict[str, object] = {}
    for field, declared in forms.fields(verb).items():
        values, kind = declared.values, forms.kind_of(declared)
        if kind == "number":
            assert values.span
            filled[field] = f"{max(values.span[0], min(values.span[1], 1)):g}"
        elif kind in ("choice", "choices"):
            filled[field] = values.choices[0] if kind == "choice" else list(values.choices)
        elif kind == "flag":
            filled[field] = True
        elif declared.argument:
            filled[field] = "thing"
    words = forms.words_of(verb, filled, lambda _: None)
    context = VerbCommand(verb).make_context(name, list(words))
    for field, value in filled.items():
        (read,) = (one for key, one in context.params.items() if key.rstrip("_") == field)
        if isinstance(value, str) and not isinstance(read, tuple | list):
            assert str(read).removesuffix(".0") == value
        elif isinstance(value, bool):
            assert read is True
        else:
            assert [*read] == ([value] if isinstance(value, str) else value)


def test_words_that_look_like_options_stay_words() -> None:
    filled = {"place": "--deep", "pace": " 4 ", "colour": "", "parts": ["wing", ""], "deep": False}
    words = forms.words_of(Survey, filled, lambda _: None)
    assert words == ["--pace=4", "--parts=wing", "--", "--deep"]
    context = VerbCommand(Survey).make_context("survey", words)
    assert context.params["place"] == "--deep"
    assert context.params["deep"] is False


@pytest.mark.parametrize(
    ("verb", "filled"),
    [
        ("train", {"task": "stranger:task"}),
        ("train", {"control": "stranger:control"}),
        ("train", {"randomize": "stranger:drones"}),
        ("train", {"accept_bounds": True}),
        ("transfer", {"reality": ["virtual:7", "stranger:Make+10ms"]}),
        ("sweep", {"trust": True}),
        ("log", {"nonsense": "1"}),
    ],
)
def test_neither_code_nor_consent_nor_what_is_unknown_passes(
    verb: str, filled: dict[str, object]
) -> None:
    with pytest.raises(InputError):
        forms.words_of(find_verb(verb), filled, lambda _: None)


def test_every_text_is_checked() -> None:
    checked: list[str] = []
    filled = {"policies": ["a", "b"], "drone": "c", "reality": "near:1@d", "trials": "2"}
    forms.words_of(find_verb("transfer"), filled, checked.append)
    assert checked == ["a", "b", "c", "near:1@d", "2"]


def test_the_command_that_comes_next_fills_its_form() -> None:
    words = ["flights", "--start", "DRONE", "--over", "latency,inertia_x", "--verbose", "-o", "d"]
    filled = forms.filled_by(find_verb("identify"), words)
    assert filled == {"logs": ["flights"], "over": ["latency,inertia_x"], "output": ["d"]}
    filled = forms.filled_by(find_verb("transfer"), ["a", "b", "--drone", "d.toml", "--overwrite"])
    assert filled == {"policies": ["a", "b"], "drone": ["d.toml"]}
    assert forms.filled_by(find_verb("train"), ["--no-such-option"]) == {}


def test_the_page_is_a_command_of_the_list() -> None:
    assert cli.commands.get_command(click.Context(cli.commands), "app") is not None
    assert not {"app", "fly"} & set(FORMS)


def test_a_form_holds_again_what_became_words() -> None:
    filled = {"policies": ["a", "b"], "trials": "2", "reality": ["near:1", "far:2"], "against": []}
    transfer = find_verb("transfer")
    words = forms.words_of(transfer, filled, lambda _: None)
    again = {"policies": ["a", "b"], "trials": ["2"], "reality": ["near:1", "far:2"]}
    assert forms.filled_by(transfer, words) == again
    validate = find_verb("validate")
    filled = {"drone": "--d", "logs": "e", "disturbances": True, "seed": "3"}
    words = forms.words_of(validate, filled, lambda _: None)
    assert forms.filled_by(validate, words) == {"drone": ["--d"], "logs": ["e"], "seed": ["3"]}
