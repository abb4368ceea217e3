"""Eschmann et al. 2024: their method on their logs, and beside it the ordinary identification.

The logs hold accelerometer, gyro and motor commands of a Crazyflie flown by hand, at 1 kHz. The
source regresses the specific force on the lagged commands, and the torque of the found curve on the
differentiated gyro. It scales the acceleration by 9.18 m/s2, although the accelerometer shows 1.000
at rest; the lag is the same with 9.81, thrust and inertia are 6.9 % larger.

    python paper/identification/eschmann_2024.py --imu ../shared/data/usd_imu -o eschmann_2024

Source: Eschmann, Albani and Loianno 2024, Data-driven system identification of quadrotors subject
to motor delays (IROS), and its logs.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars
from jaxtyping import Float
from scipy.signal import lfilter

from maidenflight import results
from maidenflight.flights.checks import checking
from maidenflight.flights.log import ACCELEROMETER_DELAY, TORQUES, Flight
from maidenflight.flights.reading import read_flights
from maidenflight.flights.tables import Table
from maidenflight.identification.identify import identify
from maidenflight.identification.likelihood.sensor_errors import AccelerometerErrors
from maidenflight.identification.likelihood.without_state import FORCE, FORCE_GROUPS
from maidenflight.identification.outcome.estimates import Identification
from maidenflight.integrations.logs import cflib, usddeck
from maidenflight.parameters import Parameters, crazyflie
from maidenflight.parameters import replace as with_values

MASS, ARM = 0.027, 0.028
"""Of the source's drone [kg], and its rotors' distance from each axis [m]."""
SLIP, GRAVITY = 9.18, 9.81
"""What the source scales the acceleration by, and what it should be [m/s2]."""
SLICES = {
    "log10": [(35.0, 65.0, "thrust and lag")],
    "log15": [(55.0, 90.0, "roll and pitch")],
    "log16": [(32.0, 38.0, "yaw"), (45.0, 49.0, "yaw")],
}
"""What the source uses of each log [s since power-on]."""
FIRST = {"log10": 26.333702, "log15": 39.244913, "log16": 16.895788}
"""When the first row of each log was stamped, likewise."""
PUBLISHED = {"T_m": 72.0, "c_0": 0.021266, "c_1": -0.011175, "c_2": 0.120130}
PUBLISHED_INERTIA = {"inertia_x": 1.0286e-5, "inertia_y": 1.1052e-5}
LAGS = np.arange(0.050, 0.100, 0.0002)
"""Lags that are tried [s]."""
THROTTLE = np.linspace(0.2, 0.9, 8)
"""Shares of the largest PWM at which curves are compared."""
MODEL = (
    "thrust_to_weight",
    "thrust_offset",
    "thrust_linear",
    "motor_time_constant",
    "latency",
    "inertia_x",
    "inertia_y",
    "torque_to_thrust",
)
"""The source's model: no coasting, no drag against climbing."""
BOTH = (*FORCE, *FORCE_GROUPS["slowing_down"], "thrust_offset")
"""Coasting and drag, and thrust of a rotor that stands: which of them do the flights want?"""


def tables(folder: Path) -> dict[str, Table]:
    """The three logs, with the time since power-on [s]."""
    late_tables = {}
    for name in SLICES:
        table = usddeck.table((folder / name).read_bytes(), name)
        late = polars.col(usddeck.CLOCK) + FIRST[name]
        late_tables[name] = replace(table, frame=table.frame.with_columns(late))
    return late_tables


def between(table: Table, start: float, stop: float) -> Table:
    """The rows between two times."""
    return replace(
        table, frame=table.frame.filter(polars.col(usddeck.CLOCK).is_between(start, stop))
    )


def slice_logs(logs: Mapping[str, Table]) -> list[Flight]:
    """What the source uses of the logs, as checked flights."""
    pieces: list[Flight] = []
    for name, table in logs.items():
        for start, stop, _ in SLICES[name]:
            for flight, time in cflib.flights(between(table, start, stop))[0]:
                pieces += checking.pieces(flight, time)[0]
    return pieces


def columns(table: Table, name: str, numbers: Sequence[object]) -> Float[np.ndarray, "N k"]:
    """Columns `name.number` of a log."""
    return table.frame.select([f"{name}.{number}" for number in numbers]).to_numpy().astype(float)


def lag_commands(table: Table, lag: float) -> Float[np.ndarray, "N 4"]:
    """Commands behind a first-order lag, as shares of the largest PWM."""
    command = columns(table, "motor", ["m1", "m2", "m3", "m4"]) / 65535
    step = float(np.median(np.diff(table.frame[usddeck.CLOCK].to_numpy())))
    memory = np.exp(-step / lag)
    return lfilter([0.0, 1 - memory], [1.0, -memory], command, axis=0, zi=command[:1])[0]


def source_thrust(table: Table, gravity: float) -> tuple[float, Float[np.ndarray, "3"]]:
    """Lag [s] and thrust curve of a motor [N] by the source's method."""
    start, stop, _ = SLICES["log10"][0]
    time = table.frame[usddeck.CLOCK].to_numpy()
    used = (time > start) & (time < stop)
    force = MASS * gravity * columns(table, "acc", ["z"])[used, 0]
    best: tuple[float, float, np.ndarray] = (np.inf, 0.0, np.zeros(3))
    for lag in LAGS:
        speed = lag_commands(table, lag)[used]
        powers = np.stack([np.full(len(speed), 4.0), speed.sum(1), (speed**2).sum(1)], axis=1)
        curve, left, *_ = np.linalg.lstsq(powers, force, rcond=None)
        best = min(best, (float(left[0]), float(lag), curve), key=lambda one: one[0])
    return best[1], best[2]


def source_inertia(
    table: Table, lag: float, curve: Float[np.ndarray, "3"]
) -> dict[str, tuple[float, float]]:
    """Inertia [kg m2] with the curve's torque regressed on the acceleration, and the other way."""
    start, stop, _ = SLICES["log15"][0]
    time = table.frame[usddeck.CLOCK].to_numpy()
    used = (time > start) & (time < stop)
    force = np.polynomial.polynomial.polyval(lag_commands(table, lag), curve)
    ratios = {}
    for axis, name in enumerate(("inertia_x", "inertia_y")):
        rate = np.radians(columns(table, "gyro", ["xyz"[axis]])[:, 0])
        both = np.cov(np.gradient(rate, time)[used], (ARM * force @ TORQUES[:, axis])[used])
        ratios[name] = (float(both[0, 1] / both[0, 0]), float(both[1, 1] / both[0, 1]))
    return ratios


def curve_of(drone: Parameters) -> Float[np.ndarray, "3"]:
    """Thrust of a motor [N] as a polynomial of its speed, which here is that of the lagged PWM."""
    full = MASS * float(drone.gravity * drone.thrust_to_weight) / 4
    offset, linear = float(drone.thrust_offset), float(drone.thrust_linear)
    return full * np.array([offset, linear, 1 - offset - linear])


def ends(drone: Identification) -> dict[str, str]:
    """Each value with its interval, in the units of the table."""
    texts = {}
    for name, estimate in drone.estimates.items():
        scale = 1e3 if name in ("motor_time_constant", "latency", "motor_coasting") else 1.0
        scale = 1e5 if name.startswith("inertia") else scale
        low, high = (scale * end for end in estimate.interval)
        texts[name] = f"{scale * estimate.value:.3g} [{low:.3g}, {high:.3g}]"
    lag = drone.posterior["motor_time_constant"] + drone.posterior["latency"]
    low, middle, high = 1e3 * (np.quantile(lag, [0.025, 0.5, 0.975]) + ACCELEROMETER_DELAY)
    texts["at the accelerometer"] = f"{middle:.3g} [{low:.3g}, {high:.3g}]"
    return texts


def main() -> None:
    """Prints and writes the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--imu", type=Path, required=True, help="folder with log10, log15, log16")
    parser.add_argument("-o", "--output", type=Path, default=Path("eschmann_2024"))
    options = parser.parse_args()
    logs = tables(options.imu)
    by_source = {scale: source_thrust(logs["log10"], scale) for scale in (SLIP, GRAVITY)}
    rows: list[dict[str, str]] = []
    for scale, (lag, curve) in by_source.items():
        inertia = source_inertia(logs["log15"], lag, curve)
        rows.append(
            {
                "acceleration times": f"{scale:g}",
                "T_m [ms]": f"{1e3 * lag:.1f}",
                "thrust [N] in 1, w, w^2": " ".join(f"{one:.5f}" for one in curve),
                "thrust / weight": f"{4 * curve.sum() / (MASS * GRAVITY):.2f}",
                "I_x, I_y [1e-5 kg m2]": ", ".join(
                    f"{1e5 * one[0]:.3f}" for one in inertia.values()
                ),
                "regressed the other way": ", ".join(
                    f"{1e5 * one[1]:.3f}" for one in inertia.values()
                ),
            }
        )
    rows.append(
        {
            "acceleration times": "published",
            "T_m [ms]": f"{PUBLISHED['T_m']:g}",
            "thrust [N] in 1, w, w^2": " ".join(f"{PUBLISHED[f'c_{n}']:.5f}" for n in range(3)),
            "I_x, I_y [1e-5 kg m2]": ", ".join(
                f"{1e5 * one:.3f}" for one in PUBLISHED_INERTIA.values()
            ),
        }
    )
    start = with_values(crazyflie(), mass=MASS)
    whole = read_flights(options.imu).flights
    identifications = {
        "whole logs": identify(whole, start=start),
        "the slices": identify(slice_logs(logs), start=start),
        "whole logs, the source's model": identify(whole, start=start, over=MODEL),
        "whole logs, thrust at standstill too": identify(whole, start=start, over=BOTH),
    }
    measured = AccelerometerErrors.of(whole)
    used = measured.signals.used
    print("errors of the accelerometer, all steps of 10 ms in the air [m/s2]:")
    for name, one in identifications.items():
        print(f"  {name}: {measured.errors(one.parameters)[used].std():.2f}")
    values = {name: ends(one) for name, one in identifications.items()}
    quantities = list(dict.fromkeys(name for one in values.values() for name in one))
    compared = polars.DataFrame(
        {
            "quantity": quantities,
            **{
                name: [one.get(quantity, "") for quantity in quantities]
                for name, one in values.items()
            },
        }
    )
    truth = np.polynomial.polynomial.polyval(THROTTLE, by_source[GRAVITY][1])
    thrust = {
        name: np.polynomial.polynomial.polyval(THROTTLE, curve_of(one.parameters)) / truth - 1
        for name, one in identifications.items()
    }
    curves = polars.DataFrame(
        {
            "throttle": THROTTLE.round(1),
            "source, 9.81 [N]": truth.round(4),
            **{f"{name} [%]": (100 * one).round(1) for name, one in thrust.items()},
        }
    )
    source = polars.DataFrame(rows)
    for name, frame in (("source", source), ("identified", compared), ("curves", curves)):
        results.write(options.output / f"{name}.csv", frame.write_csv())
        with polars.Config(
            tbl_rows=60,
            tbl_cols=20,
            tbl_hide_dataframe_shape=True,
            fmt_str_lengths=60,
            tbl_width_chars=160,
        ):
            print(frame)


if __name__ == "__main__":
    main()
