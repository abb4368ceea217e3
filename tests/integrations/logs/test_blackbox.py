"""Betaflight logs: written by a writer of our own and read back through orangebox."""

import dataclasses
import re
from pathlib import Path
from typing import Any

import jax
import made_blackbox as made
import numpy as np
import pytest
from numpy.testing import assert_allclose

import maidenflight as mf
from made_flights import sensed
from maidenflight.errors import InputError
from maidenflight.flights.log import Flight
from maidenflight.flights.reading import Flights, read_flights
from maidenflight.identification.identify import identify
from maidenflight.identification.methods import Likelihood
from maidenflight.parameters import component, crazyflie, replace

pytest.importorskip("orangebox")


def read(tmp_path: Path, *logs: bytes, name: str = "LOG00001.BFL") -> Flights:
    (tmp_path / name).write_bytes(b"".join(logs))
    return read_flights(tmp_path / name)


def same(found: Flight, flight: Flight) -> None:
    """To the steps of Betaflight's whole numbers."""
    assert not found.has_state
    assert found.period == pytest.approx(flight.period)
    assert_allclose(found.body_rates, flight.body_rates, atol=np.radians(0.051))
    assert_allclose(np.sqrt(found.command), np.sqrt(flight.command), atol=0.51 / 1999)
    measured, force = found.arrays["accelerometer"], flight.arrays["accelerometer"]
    assert_allclose(measured, force, atol=0.51 * 9.81 / 2048)


@pytest.mark.parametrize("name", ["LOG00001.BFL", "btfl_001.bbl", "log.txt"])
def test_a_flight_comes_back(name: str, tmp_path: Path) -> None:
    flight = sensed()
    (found,) = read(tmp_path, made.blackbox(made.fields_of(flight)), name=name)
    same(found, flight)
    assert_allclose(found.battery, flight.battery, atol=0.0051)
    # eRPM is in 100 electrical turns a minute, 7 to a turn of the rotor.
    step = 100 / 7 * 2 * np.pi / 60
    assert_allclose(found.arrays["rotor_speed"], flight.arrays["rotor_speed"], atol=0.51 * step)


def test_several_logs_of_a_file_are_several_flights(tmp_path: Path) -> None:
    first, second = sensed(), sensed(500, seed=3)
    broken = made.blackbox(made.fields_of(first), {"motorOutput": "0,0"})
    logs = [made.blackbox(made.fields_of(flight)) for flight in (first, second)]
    flights = read(tmp_path, *logs, broken)
    assert [len(flight) for flight in flights] == [600, 500]
    same(flights.flights[1], second)
    assert len({flight.name for flight in flights}) == 2
    assert any("log 3" in note for note in flights.notes)


def test_pwm_starts_at_mincommand(tmp_path: Path) -> None:
    flight = sensed()
    fields = made.fields_of(flight, low=1000, high=2000)
    (found,) = read(tmp_path, made.blackbox(fields, {"motorOutput": "1070,2000"}))
    assert_allclose(np.sqrt(found.command), np.sqrt(flight.command), atol=0.51e-3)


@pytest.mark.parametrize(("loop", "held"), [("16", False), ("80", True)])
def test_rows_of_the_whole_loop_hold_their_commands(loop: str, held: bool, tmp_path: Path) -> None:
    raw = made.blackbox(made.fields_of(sensed()), {"pid_process_denom": loop})
    (found,) = read(tmp_path, raw)
    assert found.zero_order_hold is held


def test_scales_and_filters_are_those_of_the_header(tmp_path: Path) -> None:
    flight = sensed()
    fields = made.fields_of(flight)
    # Counts of an MPU-6000 at 2000 deg/s, as old firmware logs them, and a gyro before its filters.
    for axis in range(3):
        fields[f"gyroUnfilt[{axis}]"] = np.round(16.4 * np.degrees(flight.body_rates[:, axis]))
    headers = {
        "gyro_scale": f"0x{int(np.float32(1 / 16.4).view(np.uint32)):x}",
        "blackbox_high_resolution": "0",
        "acc_lpf_hz": "1000",
        "gyro_lowpass_hz": "100",
    }
    (found,) = read(tmp_path, made.blackbox(fields, headers))
    assert_allclose(found.body_rates, flight.body_rates, atol=np.radians(0.51 / 16.4))
    assert found.accelerometer_delay == pytest.approx(np.sqrt(2) / (20 * np.pi))
    assert found.gyro_delay == 0.0
    assert not found.by_battery_law
    for axis in range(3):
        del fields[f"gyroUnfilt[{axis}]"]
    headers = {"acc_lpf_hz": "2500", "gyro_lpf1_static_hz": "100"}
    (filtered,) = read(tmp_path, made.blackbox(fields, headers))
    # 7.5 ms [6.0, 8.6] were measured between the filtered and the unfiltered signal of 26 flights.
    assert filtered.accelerometer_delay == pytest.approx(8.2e-3, abs=0.1e-3)
    assert filtered.gyro_delay == pytest.approx(1 / (200 * np.pi))


def test_rotor_speeds_that_are_zero_are_passed_over(tmp_path: Path) -> None:
    fields = made.fields_of(sensed())
    fields |= {f"eRPM[{motor}]": np.zeros(600, int) for motor in range(4)}
    flights = read(tmp_path, made.blackbox(fields))
    assert flights.flights[0].rotor_speed is None
    assert any("rotor_speed_4 never change" in note for note in flights.notes)


@pytest.mark.parametrize("said", ["0", "x"])
def test_without_acc_1g_gravity_shows_the_scale(said: str, tmp_path: Path) -> None:
    flight = sensed()
    flights = read(tmp_path, made.blackbox(made.fields_of(flight), {"acc_1G": said}))
    assert any("taken as 2048" in note for note in flights.notes)
    found = flights.flights[0].accelerometer
    assert found is not None
    assert found[:, 2].mean() == pytest.approx(9.81, rel=0.02)


FIELDS = made.fields_of(sensed())
REFUSED: dict[str, tuple[dict[str, Any], dict[str, str], str]] = {
    "motors as numbered": (made.fields_of(sensed(), (0, 1, 2, 3)), {}, "permuted"),
    "motors turned": (made.fields_of(sensed(), (3, 0, 1, 2)), {}, "permuted"),
    "roll rate reversed": (
        FIELDS | {"gyroADC[0]": -FIELDS["gyroADC[0]"]},
        {},
        "body_rate_x has the opp",
    ),
    "pitch rate reversed": (
        FIELDS | {"gyroADC[1]": -FIELDS["gyroADC[1]"]},
        {},
        "body_rate_y has the opp",
    ),
    "no range of motors": (FIELDS, {"motorOutput": "0,0"}, "motorOutput"),
    "no rows between": (FIELDS, {"P interval": "0/4"}, "P interval '0/4'"),
    "no whole rows": (FIELDS, {"I interval": "0"}, "I interval 0"),
    "INAV": (FIELDS, {"Firmware type": "INAV", "Firmware revision": "INAV 7"}, "a log of INAV"),
    "hexarotor": (FIELDS, {"mixerMode": "10"}, "hexarotor"),
    "mixer by name": (FIELDS, {"mixer": "HEX6X"}, "HEX6X"),
    "3D": (FIELDS, {"features": "4096"}, "3D mode"),
    "too slow": (
        made.fields_of(dataclasses.replace(sensed(), period=0.04)),
        {},
        "blackbox_sample_rate",
    ),
    **{
        f"no {name}": (
            {one if one != name else "other": values for one, values in FIELDS.items()},
            {},
            f"missing {name.partition('[')[0]}",
        )
        for name in ("time", "gyroADC[1]", "accSmooth[0]", "motor[3]")
    },
}
"""Fields, headers and what is said of them."""


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_used_is_refused_with_its_reason(what: str, tmp_path: Path) -> None:
    fields, headers, says = REFUSED[what]
    with pytest.raises(InputError, match=re.escape(says)):
        read(tmp_path, made.blackbox(fields, headers), name="log.bbl")


def test_a_log_that_was_cut_off_gives_what_is_whole(tmp_path: Path) -> None:
    raw = made.blackbox(made.fields_of(sensed()), ended=False)
    (whole,) = read(tmp_path, raw)
    assert len(whole) >= 599
    (found,) = read(tmp_path, raw[: 3 * len(raw) // 4])
    assert 400 < len(found) < 500
    for content in (raw[:100], raw[:1200], b"H Product:Blackbox", b"other"):
        (tmp_path / "log.bbl").write_bytes(content)
        with pytest.raises(InputError):
            read_flights(tmp_path / "log.bbl")


def test_damage_in_the_middle_costs_the_frames_about_it(tmp_path: Path) -> None:
    raw = bytearray(made.blackbox(made.fields_of(sensed(1200))))
    raw[len(raw) // 2 : len(raw) // 2 + 100] = b"\0" * 100
    flights = read(tmp_path, bytes(raw))
    assert sum(map(len, flights)) > 1000


@pytest.mark.night
def test_a_planted_drone_comes_back_through_a_blackbox(tmp_path: Path) -> None:
    drone = mf.virtual_drone(1)
    flown = mf.record(drone, jax.random.key(1), flights=2, duration=12.0, excitation=0.05)
    headers = {"acc_lpf_hz": "3000", "gyro_lowpass_hz": "57"}
    logs = [made.blackbox(made.fields_of(flight), headers) for flight in flown]
    flights = read(tmp_path, *logs)
    assert len(flights) == 2
    start = replace(crazyflie(), mass=drone.parameters.mass)
    found = identify(list(flights), Likelihood(trials=1), start=start).parameters
    for name, error in {"thrust_to_weight": 0.04, "inertia_x": 0.06, "inertia_y": 0.06}.items():
        value = float(component(drone.parameters, name))
        assert float(component(found, name)) == pytest.approx(value, rel=error), name
