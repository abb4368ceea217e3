"""What is true of a virtual drone, in the terms of the model that is identified."""

from collections.abc import Iterable
from pathlib import Path

from maidenflight.parameters import component, read_drone


def read_truth(reality: Path, names: Iterable[str]) -> dict[str, str | float]:
    """Reads the true parameters of what was identified; the drone has two delays, the model one.

    Args:
        reality: file of the virtual drone that was recorded.
        names: the identified parameters.

    Returns:
        By parameter: its value in SI units, or text in milliseconds.
    """
    true = read_drone(reality)
    plain: dict[str, str | float] = {name: float(component(true, name)) for name in names}
    if "latency" in plain:
        late = float(true.estimator_delay + true.gyro_time_constant)
        plain["latency"] = f"{1e3 * float(true.latency):.2g} + {1e3 * late:.2g} sensors"
    lag = float(true.motor_time_constant)
    if "motor_time_constant" in plain and "spin_down_ratio" not in plain:
        slow = lag * float(true.spin_down_ratio)
        plain["motor_time_constant"] = f"{1e3 * lag:.4g}, slowing {1e3 * slow:.4g}"
    return plain
