"""Notes on a validation: whether flights and their reading are a test of the drone."""

from collections.abc import Sequence
from pathlib import Path

from maidenflight import results
from maidenflight.identification.drone_file import DroneFile


def note_not_held_out(drone: DroneFile, paths: Sequence[Path]) -> list[str]:
    """Returns a note if a drone was identified from some of the flights, going by its record."""
    recorded_files = results.recorded_inputs(drone.record, drone.name)
    shared_count = sum(results.digest(path) in recorded_files for path in paths)
    if shared_count == 0:
        return []
    return [
        f"{Path(drone.name).name} was identified from {shared_count} of these {len(paths)} files; "
        "how well it predicts those is no test."
    ]


def note_other_law(drone: DroneFile, law: str | None) -> list[str]:
    """Returns a note if a drone was identified with another choice of the battery law."""
    settings = drone.record.get("settings", {})
    inputs = settings.get("battery_law") if isinstance(settings, dict) else None
    if inputs == law or not drone.source:
        return []
    choice = "without --battery-law" if inputs is None else f"with --battery-law {inputs!r}"
    return [
        f"{Path(drone.name).name} was identified {choice}, unlike here; thrust may differ by that "
        "alone."
    ]
