"""What may make a drone's prediction differ is noted."""

from maidenflight.identification.drone_file import DroneFile, Source
from maidenflight.identification.held_out import note_other_law
from maidenflight.parameters import crazyflie

LAW = "legacy propellers"


def test_another_battery_law_than_the_drone_s_is_said() -> None:
    """Also that a drone from anywhere else is left alone."""
    record = {"settings": {"battery_law": LAW}}
    source = Source(3, 90.0, False, "subsampled", 65535.0)
    for file, law, notes in (
        (DroneFile(crazyflie(), source=source, record=record), LAW, 0),
        (DroneFile(crazyflie(), source=source, record=record), None, 1),
        (DroneFile(crazyflie(), source=source), LAW, 1),
        (DroneFile(crazyflie()), LAW, 0),
        (DroneFile(crazyflie(), source=source, record={"settings": 3}), LAW, 1),
    ):
        assert len(note_other_law(file, law)) == notes
