"""Small logs of kinds that no reader was written with: read right, or refused for the right reason.

They lie beside the checkout; its README says what is right.
"""

from pathlib import Path

import pytest

from maidenflight.errors import InputError
from maidenflight.flights.reading import Flights, read_flights

FOLDER = Path("real") / "minimal"


def read(shared_data: Path, name: str) -> Flights:
    for package in ("pymavlink", "pyulog", "orangebox"):
        pytest.importorskip(package)
    if not (shared_data / FOLDER / name).exists():
        pytest.skip(f"{name} is not beside the checkout")
    return read_flights(shared_data / FOLDER / name)


@pytest.mark.parametrize(
    ("name", "thrust_to_weight"),
    [
        ("ap_frame34.BIN", 2.6),
        ("ap_lost_start.BIN", 2.6),
        ("ap_zero_block.BIN", 2.6),
        ("c1_brushless_erpm.csv.gz", 2.46),
        ("c5_fast_forward.bbl", 1.66),
        ("p3_dshot_outputs.ulg", 1.66),
    ],
)
def test_a_sound_log_is_read_without_a_fault(
    shared_data: Path, name: str, thrust_to_weight: float
) -> None:
    logs = read(shared_data, name)
    (checks,) = logs.checks.values()
    found = {one.name: one for one in checks}
    assert not any(one.sure for one in logs.warnings)
    assert found["thrust to weight"].statistic == pytest.approx(thrust_to_weight, rel=0.05)
    assert found["flight"].verdict in ("passes", "cannot tell")


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("b1_bench_props_off.bbl", "This is no flight"),
        ("b9_inav.TXT", "INAV"),
        ("b14_microsecond_steps.bbl", "us apart"),
        ("p1_hexa_old.ulg", "hexarotor"),
        ("telemetry.tlog", "telemetry"),
        ("u1_microsd_2019", "2019's format, missing"),
    ],
)
def test_what_cannot_be_used_is_refused_for_its_own_reason(
    shared_data: Path, name: str, reason: str
) -> None:
    with pytest.raises(InputError, match=reason):
        read(shared_data, name)


def test_electrical_speeds_of_a_brushless_crazyflie_are_read(shared_data: Path) -> None:
    (flight,) = read(shared_data, "c1_brushless_erpm.csv.gz")
    assert 500.0 < flight.arrays["rotor_speed"].mean() < 5000.0
