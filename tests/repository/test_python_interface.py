"""Python takes what the command line takes: paths, names and whole numbers for keys."""

from pathlib import Path

import jax
import numpy as np
import polars
import pytest

import maidenflight as mf
from made_flights import driven
from maidenflight import policy_file
from maidenflight.errors import InputError
from maidenflight.flights import flight_csv
from maidenflight.flights.log import Flight
from maidenflight.identification.identify import of_one_kind
from maidenflight.inputs import random_key
from maidenflight.policy import untrained_policy

FLIGHT = driven(900)
COLUMNS = {
    "time": {"columns": "t", "unit": "ms"},
    "position": list("xyz"),
    "velocity": ["vx", "vy", "vz"],
    "attitude": {"columns": ["roll", "pitch", "yaw"], "unit": "deg"},
    "body_rates": ["p", "q", "-r"],
    "motors": {"columns": ["m1", "m2", "m3", "m4"], "thrust": "linear"},
}


def table_of(flight: Flight) -> dict[str, np.ndarray]:
    rates = flight.body_rates * [1.0, 1.0, -1.0]
    parts = [flight.position, flight.velocity, np.degrees(flight.attitude), rates, flight.command]
    names = [name for signal, one in COLUMNS.items() if signal != "time" for name in _names(one)]
    rows = np.concatenate(parts, axis=1).T
    return {"t": 10.0 * np.arange(len(flight)), **dict(zip(names, rows, strict=True))}


def _names(entry: object) -> list[str]:
    columns = entry["columns"] if isinstance(entry, dict) else entry
    assert isinstance(columns, list)
    return [str(one).removeprefix("-") for one in columns]


class Frame(dict):
    """What pandas' tables have in common with any other: columns by their names."""

    @property
    def columns(self) -> list[str]:
        return list(self)


@pytest.mark.parametrize("frame", [Frame, polars.DataFrame])
def test_a_table_with_a_map_of_columns_is_a_flight(frame: type) -> None:
    flight = Flight.from_frame(frame(table_of(FLIGHT)), COLUMNS, "mine", zero_order_hold=True)
    assert (flight.name, flight.period, len(flight)) == ("mine", 0.01, len(FLIGHT))
    assert flight.zero_order_hold
    assert not flight.assumed
    for name in ("position", "velocity", "attitude", "body_rates", "command"):
        np.testing.assert_allclose(getattr(flight, name), getattr(FLIGHT, name), atol=1e-5)


def test_a_table_without_a_column_or_against_physics_is_refused() -> None:
    rows = polars.DataFrame(table_of(FLIGHT))
    with pytest.raises(InputError, match="m3"):
        Flight.from_frame(rows.drop("m3"), COLUMNS)
    with pytest.raises(InputError, match="time missing"):
        Flight.from_frame(rows, {name: one for name, one in COLUMNS.items() if name != "time"})
    turned = COLUMNS | {"motors": {"columns": ["m4", "m3", "m2", "m1"], "thrust": "linear"}}
    with pytest.raises(InputError, match="permuted"):
        Flight.from_frame(rows, turned)


def test_logs_are_read_by_their_path_and_a_whole_number_is_a_key(tmp_path: Path) -> None:
    flight_csv.write(tmp_path / "logs" / "a.csv", FLIGHT)
    flights, notes = of_one_kind(tmp_path / "logs")
    assert (len(flights), notes) == (1, [])
    with pytest.raises(InputError, match="no such file"):
        mf.identify(str(tmp_path / "nothing"))
    with pytest.raises(InputError, match="crazyfly"):
        mf.identify(tmp_path / "logs", start="crazyfly")
    for key in (3, jax.random.key(3)):
        assert random_key(key) == jax.random.key(3)


@pytest.mark.slow
def test_a_policy_file_is_exported_and_flown_by_its_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    policy_file.write_policy("p.json", untrained_policy(jax.random.key(0)))
    assert [str(path) for path in mf.export("p.json")] == ["firmware/policy.h", "firmware/policy.c"]
    evaluation = mf.transfer("p.json", trials=1, key=0, duration=0.05)
    assert evaluation.table["policy"].to_list() == ["p"]
    assert evaluation.table["reality"].to_list() == ["virtual:7"]
    with pytest.raises(InputError, match=r"no\.json"):
        mf.export("no.json")


def test_mistyped_names_and_numbers_are_said() -> None:
    with pytest.raises(AttributeError, match="Did you mean identify"):
        getattr(mf, "identfy")  # noqa: B009
    with pytest.raises(InputError, match="updates = -3"):
        mf.AnalyticGradient(updates=-3)
    with pytest.raises(InputError, match="num_envs = 0"):
        mf.PPO(num_envs=0)
    drones = jax.vmap(mf.simulator.relative_box(mf.crazyflie()).draw)(
        jax.random.split(jax.random.key(0), 500)
    )
    assert repr(drones) == "<Parameters of 500 drones>"
