from pathlib import Path
from typing import Any

import polars
import pytest

from maidenflight.errors import InputError
from scripts import script


@pytest.fixture(scope="module")
def claims() -> Any:
    return script("claims")


def fly(times: dict[tuple[str, float, float], list[float]]) -> polars.DataFrame:
    """Returns flights by control structure, motor lag [s] and latency [s] in training."""
    rows = [
        {"control": control, "motor_time_constant": lag, "latency": latency, "duration": duration}
        for (control, lag, latency), durations in times.items()
        for duration in durations
    ]
    return polars.DataFrame(rows)


FLIGHTS = fly(
    {
        ("pwm", 0.08, 0.0): [0.5, 0.7],
        ("pwm", 0.08, 0.02): [20.0, 20.0, 3.0],
        ("attitude_rate", 0.08, 0.0): [9.0],
        ("attitude_rate", 0.08, 0.02): [15.0],
        ("attitude", 0.08, 0.0): [5.0],
        ("attitude", 0.08, 0.02): [6.0],
    }
)


def test_claims_on_flight_times(claims: Any) -> None:
    verdicts = {
        claim.words: claim.judge(FLIGHTS).verdict
        for claim in claims.CLAIMS
        if claim.table == "zero_shot"
    }
    assert set(verdicts.values()) == {"reproduced"}
    assert len(verdicts) == 7


def test_the_other_end_of_an_order_is_the_opposite(claims: Any) -> None:
    values = {"a": 1.0, "b": 2.0, "c": 3.0}
    verdicts = [claims.judge_order(values, name, "s", best=True).verdict for name in "abc"]
    assert verdicts == ["the opposite", "not seen", "reproduced"]
    assert claims.judge_order(values, "a", "s", best=False).verdict == "reproduced"


def test_a_history_and_a_length_of_windows(claims: Any) -> None:
    policies = polars.DataFrame(
        {
            "hidden": ["50x50"] * 4 + ["8x8"],
            "history": [1, 2, 2, 8, 2],
            "episode_return": [-20.0, -9.0, -11.0, -7.0, 0.0],
        }
    )
    assert claims.judge_history(policies).verdict == "not seen"
    rows = [
        {
            "flights": "virtual",
            "method": "bayesian",
            "length": length,
            "parameter": name,
            "trial_mean": mean if length > 10 else 2 * mean,
        }
        for length, values in claims.PAPER.items()
        for name, (mean, _) in values.items()
    ]
    assert claims.judge_lengths(polars.DataFrame(rows)).verdict == "reproduced"
    rows[-1]["trial_mean"] += 0.01
    assert claims.judge_lengths(polars.DataFrame(rows)).verdict == "not seen"


@pytest.mark.parametrize(
    ("worse", "verdict"), [(-9.0, "reproduced"), (9.0, "the opposite"), (0.0, "not seen")]
)
def test_a_change_counts_by_its_interval(claims: Any, worse: float, verdict: str) -> None:
    rows = [
        {
            "control": "pwm",
            "variant": variant,
            "policy": number,
            "reality": "itself",
            "duration": 10.0 + shift + 0.1 * number,
            **dict.fromkeys(("position_error", "beyond", "change", "at_limits"), 0.0),
        }
        for variant, shift in (("as the paper", 0.0), ("neither penalty", worse))
        for number in (1, 2, 3)
    ]
    changes = claims.find_effects(polars.DataFrame(rows))
    assert claims.judge_loss(changes, "pwm", "neither penalty").verdict == verdict
    with pytest.raises(InputError, match="no flights"):
        claims.judge_loss(changes, "pwm", "no latency")


def test_columns_stand_beside_each_other_and_absent_ones_stay_empty(
    claims: Any, tmp_path: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "zero_shot").mkdir()
    FLIGHTS.write_csv(tmp_path / "zero_shot" / "flights.csv")
    claims.main(["--results", f"PPO={tmp_path}"])
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 + len(claims.CLAIMS)
    assert sum(line.endswith("| - |") for line in lines) == 7
    with pytest.raises(InputError, match="holds none"):
        claims.read_tables(tmp_path / "nothing")
    with pytest.raises(SystemExit):
        claims.main(["--results", str(tmp_path)])


def test_the_table_goes_between_the_marks_of_a_page(claims: Any, tmp_path: Path) -> None:
    page = f"before\n{claims.BEGIN}\nold\n{claims.END}\nafter\n"
    new = claims.replace_table(page, "new")
    assert new == page.replace("old", "new")
    with pytest.raises(InputError):
        claims.replace_table(f"{claims.END} {claims.BEGIN}", "new")


def test_the_papers_page_holds_a_row_for_each_claim(claims: Any) -> None:
    page = (Path(claims.__file__).parent / "notes/paper.md").read_text("utf-8")
    table = page.partition(claims.BEGIN)[2].partition(claims.END)[0]
    rows = [line.split(" | ")[0].removeprefix("| ") for line in table.splitlines()[3:]]
    assert rows == [claim.words for claim in claims.CLAIMS]


def test_the_script_writes_page_and_figure(claims: Any, tmp_path: Path) -> None:
    flights = FLIGHTS.with_columns(polars.lit("a guard").alias("end_reason"))
    (tmp_path / "zero_shot").mkdir()
    flights.write_csv(tmp_path / "zero_shot/flights.csv")
    page = tmp_path / "page.md"
    page.write_text(f"{claims.BEGIN}\n{claims.END}\n")
    given = ["--results", f"PPO={tmp_path}", "--page", page, "--figure", tmp_path / "times.svg"]
    claims.main([str(one) for one in given])
    assert "| claim | PPO |" in page.read_text()
    assert "PPO: latency 20 ms in training" in (tmp_path / "times.svg").read_text()
