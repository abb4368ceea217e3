"""What a matrix's file may say."""

from pathlib import Path

import pytest
from test_matrix import TINY, put

from maidenflight.errors import InputError
from maidenflight.experiments import matrix_file


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("trials = 2", "trials =", "not settings of a matrix"),
        ("trials = 2", "trials = 0", "trials = 0; expected at least 1"),
        ("trials = 2", "trails = 2", "trails is unknown.*trials"),
        ("trials = 2", 'trials = "2"', "trials = '2'; expected a whole number"),
        ("trials = 2", "trials = true", "trials = True; expected a whole number"),
        ("latency = [0.0]", "latency = []", "latency = .*at least one time"),
        ("latency = [0.0]", "", "latency = .*at least one time"),
        ("latency = [0.0]", "latency = [-0.1]", "latency = .*at least one time"),
        ("latency = [0.0]", "latency = 0.1", "latency = 0.1; expected a list"),
        ("duration = 1", "duration = 0", "duration above 0"),
        ("[control.attitude]", "[control.thrust]", r"control\.thrust\] is unknown.*attitude_rate"),
        ("rate = 100", "rate = 30", "does not divide"),
        ("[control.attitude]", "[control.pwm]\nrate = 50\n[control.attitude]", "pwm at 50 Hz"),
        ("updates = 2", "update = 2", r"\[control\.attitude\] update is unknown.*updates"),
        ("updates = 2", "updates = 2.5", r"\[control\.attitude\] updates = 2\.5; expected int"),
        ("[control.attitude]", "[controls.attitude]", "no control structure"),
    ],
)
def test_a_file_that_makes_no_sense_is_refused_in_words(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        matrix_file.read(put(tmp_path, TINY.replace(old, new)))


def test_a_file_that_is_not_there() -> None:
    with pytest.raises(InputError, match=r"zero_shot\.toml"):
        matrix_file.read("nowhere.toml")
