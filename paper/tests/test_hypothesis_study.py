"""The statistic of the paper's hypothesis finds slopes that were planted, and none where there is
none."""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import polars
import pytest

from maidenflight import parameters
from scripts import script

LAGS, LATENCIES = (0.04, 0.08, 0.12), (0.0, 0.015, 0.02)
FEW = ["--resamples", "400"]


@pytest.fixture(scope="module")
def hypothesis() -> Any:
    return script("hypothesis")


def flights(
    slopes: Mapping[str, float],
    reality_lag: float,
    signed: bool = False,
    rates: Mapping[str, int] | None = None,
) -> polars.DataFrame:
    """Three policies a cell, three flights each: 12 s less so many seconds per 10 ms of distance
    from the reality's lag, and noise."""
    noise, rows = np.random.default_rng(0), []
    for kind, slope in slopes.items():
        for lag in LAGS:
            for latency in LATENCIES:
                off = 100 * (lag + latency - reality_lag)
                for number in (1, 2, 3):
                    base = 10.0 + slope * (off if signed else abs(off)) + noise.normal(0.0, 0.7)
                    one = {
                        "control": kind,
                        "motor_time_constant": lag,
                        "latency": latency,
                        "number": number,
                        "reality": "made-up",
                    }
                    rate = {} if rates is None else {"training_rate": rates[kind]}
                    lasting = [base + more for more in noise.normal(0.0, 0.3, 3)]
                    rows += [
                        {
                            **one,
                            **rate,
                            "trial": trial,
                            "duration": max(0.1, time),
                            "end_reason": "tilt",
                            "position_error": 0.1,
                        }
                        for trial, time in enumerate(lasting, 1)
                    ]
    return polars.DataFrame(rows)


def written(table: polars.DataFrame, path: Path, **record: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(
        "# zero-shot flights\n# record: "
        f"{json.dumps({'seed': 0, 'settings': {}, **record})}\n{table.write_csv()}"
    )
    return path


def statistics(folder: Path) -> polars.DataFrame:
    return polars.read_csv(folder / "statistics.csv", comment_prefix="#").with_columns(
        polars.col("less", "against").fill_null("")
    )


def found(table: polars.DataFrame, **wanted: str) -> dict[str, Any]:
    return table.filter(
        **{"statistic": "slope", "of": "flight time", "unit": "policy", "less": "", **wanted}
    ).row(0, named=True)


def holds(row: Mapping[str, Any], value: float) -> bool:
    return row["low"] <= value <= row["high"]


def test_lags_are_counted_as_said(hypothesis: Any) -> None:
    drone = parameters.replace(
        parameters.crazyflie(), motor_time_constant=0.05, spin_down_ratio=2.0, latency=0.01
    )
    assert hypothesis.total_lag(drone) == pytest.approx(0.085)
    assert hypothesis.total_lag(
        parameters.replace(drone, estimator_delay=0.006, gyro_time_constant=0.002)
    ) == pytest.approx(0.089)


def test_planted_slopes_are_found_and_the_hypothesis_with_them(
    hypothesis: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    planted = {"pwm": -1.5, "attitude_rate": -0.7, "attitude": -0.2}
    table = written(flights(planted, 0.085), tmp_path / "flights.csv")
    arguments = [str(table), "--lag", "made-up=0.085", *FEW, "-o", str(tmp_path / "made")]
    hypothesis.main(arguments)
    told = capsys.readouterr().out
    assert (
        "made-up, matching rates, by distance: holds (pwm falls; more steeply than attitude_rate, "
        "more steeply than attitude)" in told
    )
    data = statistics(tmp_path / "made")
    for kind, slope in planted.items():
        row = found(data, control=kind, against="distance")
        assert holds(row, slope)
        assert (row["policies"], row["flights"], row["in"]) == (27, 81, "s/10 ms")
    difference = found(data, less="attitude_rate", control="pwm", against="distance")
    assert holds(difference, -0.8)
    assert difference["policies"] == 54
    correlation = data.filter(
        statistic="rank correlation", control="pwm", less="", against="distance"
    ).row(0, named=True)
    assert correlation["value"] < -0.9

    picture, before = (
        tmp_path / "made" / "hypothesis.svg",
        (tmp_path / "made" / "statistics.csv").read_bytes(),
    )
    assert ">made-up, matching rates</" in picture.read_text()
    picture.unlink()
    hypothesis.main(arguments)
    assert picture.exists()
    assert (tmp_path / "made" / "statistics.csv").read_bytes() == before


def test_intervals_hold_what_was_planted_and_nothing_when_flight_times_are_shuffled(
    hypothesis: Any,
) -> None:
    """Of a hundred made-up matrices each; 95 % would be right, 90 is what is promised."""
    x, hits = np.repeat(np.array([-4.5, -3.0, -2.5, -0.5, 1.0, 1.5, 3.5, 5.0, 5.5]), 2), np.zeros(4)
    for number in range(100):
        draw = np.random.default_rng([5, number])
        one, other = (
            (x, 10.0 + slope * x + draw.normal(0.0, 3.0, x.shape)) for slope in (0.5, 1.5)
        )
        shuffled = [(x, draw.permutation(y)) for _, y in (one, other)]
        asked = [
            (other, None, 1.5),
            (one, other, -1.0),
            (shuffled[0], None, 0.0),
            (shuffled[0], shuffled[1], 0.0),
        ]
        for place, (sample, less, planted) in enumerate(asked):
            told = sys.modules["hypothesis_statistics"].estimate_difference(
                hypothesis.slope, sample, less, resamples=400
            )
            hits[place] += told.low <= planted <= told.high
    assert (hits >= 86).all(), hits


def test_shuffled_flights_tell_nothing(
    hypothesis: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, order, shuffled = (
        flights(dict.fromkeys(hypothesis.CONTROLS, -1.5), 0.085),
        np.random.default_rng(3),
        [],
    )
    for _, part in table.group_by("control", maintain_order=True):
        times = order.permutation(part["duration"].to_numpy().reshape(-1, 3))
        shuffled.append(part.with_columns(polars.Series("duration", times.ravel())))
    path = written(polars.concat(shuffled), tmp_path / "flights.csv")
    hypothesis.main([str(path), "--lag", "made-up=0.085", *FEW, "-o", str(tmp_path)])
    told = capsys.readouterr().out
    assert "by distance: cannot tell" in told
    assert "by lag: cannot tell" in told


def test_it_does_not_hold_where_another_structure_falls_more_steeply(
    hypothesis: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(
        flights({"pwm": 0.3, "attitude_rate": 0.3, "attitude": 1.0}, 0.09, signed=True),
        tmp_path / "flights.csv",
    )
    hypothesis.main([str(path), "--lag", "made-up=0.09", *FEW, "-o", str(tmp_path)])
    told = capsys.readouterr().out
    assert (
        "by lag: does not hold (pwm falls; not surely otherwise than attitude_rate, less steeply "
        "than attitude)" in told
    )
    assert holds(found(statistics(tmp_path), control="attitude", against="lag"), 1.0)


def test_what_is_due_to_the_rate_of_training_is_told(
    hypothesis: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Attitude policies fly as well as others where they were trained at their own rate, and fall
    at once where not."""
    own = {"pwm": 100, "attitude_rate": 50, "attitude": 25}
    matching = flights({"pwm": 1.0, "attitude_rate": 0.5, "attitude": 0.5}, 0.09, True, own)
    matching = matching.with_columns(
        polars.col("duration") + polars.when(control="attitude").then(6.0).otherwise(0.0)
    )
    other = flights(
        {"pwm": 1.0, "attitude_rate": 0.5, "attitude": 0.1}, 0.09, True, dict.fromkeys(own, 100)
    ).filter(polars.col("control") != "pwm")
    other = other.with_columns(
        (polars.col("duration") - polars.when(control="attitude").then(8.0).otherwise(0.0)).clip(
            lower_bound=0.1
        )
    )
    paths = [
        written(matching, tmp_path / "own" / "flights.csv"),
        written(other, tmp_path / "100" / "flights.csv"),
    ]
    hypothesis.main([*map(str, paths), "--lag", "made-up=0.09", *FEW, "-o", str(tmp_path)])
    told = capsys.readouterr().out
    assert (
        "made-up: attitude, trained at 100 Hz, is surely the worst, and with matching rates "
        "surely not the worst" in told
    )
    assert "An artefact of the rates." in told
    data = statistics(tmp_path)
    pwm = data.filter(control="pwm", less="", statistic="mean", of="flight time")
    assert pwm["data"].to_list() == ["made-up, matching rates", "made-up, trained at 100 Hz"]
    assert pwm["value"].n_unique() == 1
    change = data.filter(
        control="attitude", less="made-up, trained at 100 Hz", statistic="mean", of="flight time"
    ).row(0, named=True)
    assert holds(change, 14.0)

    hypothesis.main(
        [
            *map(str, paths),
            str(paths[0]),
            "--lag",
            "made-up=0.09",
            *FEW,
            "-o",
            str(tmp_path / "again"),
        ]
    )
    assert statistics(tmp_path / "again").equals(data)


def test_real_flights_have_the_latencies_that_were_trained(
    hypothesis: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    planted = flights({"pwm": 1.2, "attitude_rate": 0.6, "attitude": 0.2}, 0.09, signed=True)
    policy = (
        polars.concat_str(polars.col("motor_time_constant", "latency", "number"))
        .rank("dense")
        .alias("policy")
    )
    renamed = {
        "motor_time_constant": "trained_motor_time_constant_s",
        "latency": "trained_latency_s",
        "duration": "flight_time_s",
    }
    authors = planted.with_columns(policy, in_paper=True).rename(renamed)
    unreported = authors.filter(control="pwm").with_columns(in_paper=False, flight_time_s=0.1)
    polars.concat([authors, unreported]).write_csv(tmp_path / "flights.csv")
    hypothesis.main(["--authors", str(tmp_path), *FEW, "-o", str(tmp_path / "made")])
    assert "real, trained at 100 Hz, by lag: holds" in capsys.readouterr().out
    data = statistics(tmp_path / "made")
    assert set(data["data"]) == {"real, trained at 100 Hz"}
    assert data.filter(less="")["policies"].unique().to_list() == [27]
    policies = hypothesis.average_policies(
        hypothesis.read_real_flights(tmp_path), parameters.crazyflie()
    )
    assert sorted(policies["latency"].unique().round(6)) == [0.0, 0.01, 0.02]
    identified = hypothesis.total_lag(
        parameters.replace(parameters.crazyflie(), **hypothesis.IDENTIFIED)
    )
    assert identified == pytest.approx(0.0872, abs=1e-4)


def test_flights_of_20_s_all_over_have_no_slope(
    hypothesis: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = flights({"pwm": 0.0, "attitude": 0.0}, 0.09).with_columns(duration=25.0)
    hypothesis.main(
        [
            str(written(table, tmp_path / "flights.csv")),
            "--lag",
            "made-up=0.09",
            *FEW,
            "-o",
            str(tmp_path),
        ]
    )
    row = found(statistics(tmp_path), control="pwm", against="lag")
    assert (row["value"], row["low"], row["high"]) == (0.0, 0.0, 0.0)
    assert (
        "cannot tell (pwm neither falls nor rises surely; not surely otherwise than attitude)"
        in capsys.readouterr().out
    )


def test_names_of_realities_are_understood(hypothesis: Any, tmp_path: Path) -> None:
    table = flights({"pwm": -1.0}, 0.09)
    truth = hypothesis.total_lag(hypothesis.find_reality("virtual:7").parameters)
    parameters.write_drone(
        tmp_path / "drone.toml", parameters.replace(parameters.crazyflie(), latency=0.003), {}
    )
    both = polars.concat(
        [
            table.with_columns(reality=polars.lit(name))
            for name in ("virtual:7", "pybullet:7", "mine")
        ]
    )
    path = written(both, tmp_path / "flights.csv")
    hypothesis.main(
        [str(path), "--reality", f"mine={tmp_path / 'drone.toml'}", *FEW, "-o", str(tmp_path)]
    )
    record = (tmp_path / "statistics.csv").read_text().splitlines()[1].removeprefix("# record: ")
    lags = json.loads(record)["settings"]["total_lag"]
    assert lags == {
        "virtual:7": pytest.approx(truth, abs=1e-6),
        "pybullet:7": pytest.approx(truth, abs=1e-6),
        "mine": pytest.approx(0.091),
    }


def test_mistakes_are_named(
    hypothesis: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = flights({"pwm": -1.0, "attitude": -1.0}, 0.09)
    path = written(good, tmp_path / "flights.csv")
    known = ["--lag", "made-up=0.09"]

    def refused(*arguments: Any) -> str:
        with pytest.raises(SystemExit):
            hypothesis.main([*map(str, arguments), *FEW, "-o", str(tmp_path / "none")])
        assert not (tmp_path / "none").exists()
        return capsys.readouterr().err

    assert "nothing to read" in refused()
    assert "not a table of zero-shot flights" in refused(tmp_path / "nowhere.csv")
    assert "not a table of zero-shot flights" in refused(
        written(good.drop("latency"), tmp_path / "short.csv")
    )
    strange = good.with_columns(control=polars.lit("thrust"))
    assert "Expected a row a flight of pwm, attitude_rate, attitude" in refused(
        written(strange, tmp_path / "strange.csv"), *known
    )
    gap = good.with_columns(
        duration=polars.when(polars.int_range(polars.len()) > 0).then("duration")
    )
    assert "1 flights with gaps" in refused(written(gap, tmp_path / "gap.csv"), *known)
    assert "cut after 5 s" in refused(
        written(good, tmp_path / "cut.csv", settings={"duration": 5.0}), *known
    )
    assert "trained around heavy.toml" in refused(
        written(good, tmp_path / "drone.csv", settings={"drone": "heavy.toml"}), *known
    )
    assert "reality made-up is unknown" in refused(path)
    assert "no flight in virtual:7" in refused(path, *known, "--lag", "virtual:7=0.1")
    assert "expected NAME=VALUE" in refused(path, "--lag", "0.09")
    assert "expected seconds" in refused(path, "--lag", "made-up=90")
    assert "told twice" in refused(
        path, written(good.with_columns(duration=1.0), tmp_path / "other.csv"), *known
    )
    assert "at least 3 lags" in refused(
        written(good.filter(polars.col("number") == 1).head(9), tmp_path / "few.csv"), *known
    )
    assert "called real" in refused(
        written(good.with_columns(reality=polars.lit("real")), tmp_path / "real.csv")
    )
    assert "at least 3 lags" in refused(path, "--least-latency", "0.03", *known)
    assert "not the authors' data" in refused("--authors", tmp_path / "nowhere")
    assert "not the authors' flights" in refused("--authors", tmp_path)
