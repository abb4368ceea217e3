"""The literature: its values are plausible, and what was identified stands beside them."""

from pathlib import Path

import pytest

from maidenflight.errors import InputError
from maidenflight.identification.drone_file import DroneFile, Estimate, Search, Source
from maidenflight.parameters import COMPONENTS, QUANTITIES, crazyflie
from reporting.drawn import of, rows
from scripts import script

literature = script("literature")
FOUND = {"motor_time_constant": Estimate(0.176, (0.132, 0.22), (0.176,), 0.0)}


def test_what_others_give_is_within_the_bounds_of_the_parameter() -> None:
    for name, (field, _) in COMPONENTS.items():
        for source, value in literature.list_published(name).items():
            assert QUANTITIES[field].lower <= value <= QUANTITIES[field].upper
            assert source


def test_values_are_multiples_of_the_papers_and_said_as_they_are() -> None:
    figure = literature.beside_literature(FOUND, {"motor_time_constant": (0.088, 0.132)})
    bar, value = of(figure, series="identified")
    assert (bar["x"], bar["x2"], value["x"]) == pytest.approx((1.5, 2.5, 2.0))
    assert value["value"] == "176 ms"
    assert [one["x"] for one in of(figure, series="paper")] == [1.0]
    assert [one["x"] for one in of(figure, series="truth", kind="end")] == pytest.approx([1.0, 1.5])
    others = {one["source"]: one["x"] for one in of(figure, series="others")}
    for source, given in literature.list_published("motor_time_constant").items():
        assert others[source] == pytest.approx(given / 0.088, rel=1e-5)
    low, high = figure.panels[0]["layer"][-1]["encoding"]["x"]["scale"]["domain"]
    assert all(low < row["x"] < high for row in rows(figure))
    with pytest.raises(InputError, match="no parameter"):
        literature.beside_literature({"drag_x": Estimate(0.3, (0.2, 0.4), (0.3,), 0.0)})


def test_a_drone_file_is_drawn_beside_the_literature(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drone, truth = tmp_path / "drone.toml", tmp_path / "truth.toml"
    source, search = Source(2, 20.0, True, "subsampled", 60000.0), Search("replay", 1.0, 258, 9)
    DroneFile(crazyflie(), FOUND, source=source, search=search).write(drone)
    DroneFile(crazyflie()).write(truth)
    literature.main([str(drone), "--truth", str(truth), "-o", str(tmp_path / "made.svg")])
    assert "SimpleFlight 2025" in capsys.readouterr().out
    assert "identified, 95 % interval" in (tmp_path / "made.svg").read_text()
