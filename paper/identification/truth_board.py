"""What identification finds on public drones of which something was measured, beside the truth.

Measured rotor speeds are hidden and used only to judge, but INDIflight's, whose bench is the truth.
Drones of other simulators are recorded first, and identified from three starts; they are left out
where their packages are not installed. Writes paper/notes/truth-board.md and a CSV; `--only`
computes some drones again, and `--lag` adds the lag of every log and folder at 500, 250 and 100 Hz.

    python paper/identification/truth_board.py --data ../shared/data -o truth_board
"""

import argparse
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import jax
import numpy as np
import polars
from scipy.signal import butter, sosfiltfilt

import maidenflight as mf
from maidenflight import results
from maidenflight.errors import InputError, require_packages
from maidenflight.experiments.drones import find_reality
from maidenflight.flights.log import Flight, by_log, thinned
from maidenflight.flights.reading import read_flights
from maidenflight.flights.trims import rotors
from maidenflight.flying.recording import record
from maidenflight.identification.likelihood.measured import measure
from maidenflight.identification.outcome.estimates import Identification
from maidenflight.identification.outcome.plausible import HOVERING
from maidenflight.identification.outcome.problem import Problem
from maidenflight.identification.signals.lag import LAG, SLOWING_DOWN
from maidenflight.identification.signals.thrust_law import thrust_law
from maidenflight.identification.start import read_start
from maidenflight.parameters import Parameters, arm_length, component, crazyflie
from maidenflight.parameters import replace as changed
from maidenflight.simulator.physics.dynamics import equivalent_lag

PAGE = Path(__file__).parents[1] / "notes" / "truth-board.md"
TOTAL = "lag + latency"
"""Of the equivalent lag, speeding up and slowing down."""
PER_SQUARE = "thrust by squared speed [N s2]"
"""Of a rotor, where speeds were measured: what the identified curve gives, over them."""
FORCES = {
    "force by weight at throttle 0.25, 11.3 V": (0.25, 11.3),
    "force by weight at throttle 0.5, 10.6 V": (0.5, 10.6),
    "force by weight at throttle 0.9, 9.2 V": (0.9, 9.2),
}
"""Throttle and battery voltage at which force was measured in steady flight."""
LAG_FOLDERS = ("brushed", "brushless", "payload")
EVERY = (1, 2, 5)
"""Rows of a log to one that is kept, in the table of lags."""


@dataclass(frozen=True)
class Drone:
    """A public drone."""

    files: tuple[str, ...]
    """Patterns below the data's folder."""
    start: str
    """Named drone to begin with."""
    mass: float | None
    """[g]; None for the named drone's."""
    truth: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Lowest and highest measured value by parameter, SI units; `TOTAL` is a sum."""
    source: str = ""
    hide: bool = True
    """Whether measured speeds are hidden."""
    columns: str = ""
    """Map of the files' columns, where they are tables without one."""
    arms: tuple[float, float] | None = None
    """Distance of the rotors from the middle along x and y [m]; None for the named drone's."""

    @property
    def parameters(self) -> Parameters:
        """Where the identification begins: inertia grows with mass and squared arm."""
        named = read_start(self.start, self.mass).parameters
        if self.arms is None:
            return named
        sides = (
            np.sign(one) * arm
            for one, arm in zip((named.rotor_x, named.rotor_y), self.arms, strict=True)
        )
        own = changed(named, **dict(zip(("rotor_x", "rotor_y"), sides, strict=True)))
        share = (arm_length(own) / arm_length(named)) ** 2
        return changed(own, inertia=np.float32(share) * np.asarray(named.inertia))


NANODRONE = """
time.columns = ["t"]
position.columns = ["x", "y", "z"]
velocity.columns = ["vx", "vy", "vz"]
attitude.columns = ["qx", "qy", "qz", "qw"]
body_rates.columns = ["wx", "wy", "wz"]
motors.columns = ["m1_thrust", "m2_thrust", "m3_thrust", "m4_thrust"]
motors.low = 0
motors.high = 1
motors.thrust = "linear"
rotor_speed.columns = ["m1_erpm", "m2_erpm", "m3_erpm", "m4_erpm"]
rotor_speed.unit = "rpm"
"""
"""Columns of IDSIA's benchmark; of its speeds, six to a turn, only proportions count."""

DRONES = {
    "brushed": Drone(
        ("usd/brushed/jana*",), "crazyflie_2.0", 34.7, {TOTAL: (0.080, 0.089)}, "rotor speeds"
    ),
    "brushless": Drone(
        ("usd/brushless/eckart*",),
        "crazyflie_brushless",
        37.0,
        {TOTAL: (0.042, 0.046)},
        "rotor speeds",
    ),
    "payload": Drone(
        ("usd/payload/eckart*",),
        "crazyflie_brushless",
        44.4,
        {TOTAL: (0.037, 0.044)},
        "rotor speeds",
    ),
    "IMU only": Drone(
        ("usd_imu/log*",),
        "crazyflie",
        27.0,
        {
            "motor_time_constant": (0.0716, 0.073),
            "thrust_to_weight": (2.10, 2.10),
            "inertia_x": (1.09e-5, 1.27e-5),
            "inertia_y": (1.16e-5, 1.41e-5),
        },
        "Eschmann et al. 2024, scaled to 9.81; regressed both ways",
    ),
    "INDIflight": Drone(
        ("real/indiflight/*.BFL",),
        "racer_5_inch",
        428.0,
        {
            TOTAL: (0.0265, 0.0285),
            PER_SQUARE: (2.66e-7, 2.66e-7),
            "thrust_to_weight": (4.29, 4.29),
            "thrust_linear": (0.54, 0.54),
            "inertia_x": (7.206e-4, 7.206e-4),
            "inertia_y": (7.757e-4, 7.757e-4),
        },
        "bench; inertia by a pendulum, 8 % by its makers",
        hide=False,
        arms=(0.0455, 0.0635),
    ),
    "neural-swarm": Drone(
        ("real/neural_swarm/randomwalk*",),
        "crazyflie_2.0",
        34.0,
        {"thrust_to_weight": (1.48, 1.55)},
        "load cell at the PWM of u = 1, 83 % at 3.69 V and 88 % at 3.49 V; over 34 g, and over "
        "what it says of hovering",
    ),
    "SimpleFlight cf0": Drone(
        ("real/simpleflight/cf0*",),
        "crazyflie_2.0",
        32.1,
        {"motor_time_constant": (0.025, 0.025)},
        "their search, not measured",
    ),
    "NanoDrone": Drone(
        ("nanodrone/*.parquet",),
        "crazyflie_brushless",
        45.0,
        {"inertia_x": (3.3e-5, 3.3e-5), "inertia_y": (3.6e-5, 3.6e-5)},
        "Graefe et al. 2026, a Crazyflie Brushless of 44 g; its speeds are used",
        hide=False,
        columns=NANODRONE,
    ),
    "better_tune": Drone(
        ("real/betaflight/better_tune.BBL",),
        "racer_5_inch",
        650.0,
        dict(zip(FORCES, ((0.87, 1.17), (1.97, 2.67), (2.47, 3.34)), strict=True)),
        "medians of its accelerometer over 0.12 s of steady flight, 15 %",
        hide=False,
    ),
    "NanoBench": Drone(
        tuple(
            f"nanobench/{flight}_rep1.csv.gz"
            for flight in ("B2_circle_fast", "B2_circle_medium", "B3_figure8_fast", "B7_oval_fast")
        ),
        "crazyflie_2.1+",
        None,
        {"thrust_to_weight": (1.122, 1.122)},
        "weight over mean command",
    ),
}


SIMULATED = (
    "l2f:crazyflie",
    "l2f:crazyflie+sensors",
    "crazyflow:cf21B_500",
    "crazyflow:cf21B_500+sensors",
    "crazyflow:cf2x_L250",
    "crazyflow:cf2x_L250+sensors",
)
"""Drones of other simulators, without and with the noise of sensors."""
PARAMETERS = ("thrust_to_weight", "motor_time_constant", "inertia_x", "inertia_y")
"""What of them stands on the board."""


def starts(truth: Parameters) -> Mapping[str, Parameters]:
    """The Crazyflie, one of a drone's mass and arm, and one that is also heavy and lags."""
    own = changed(crazyflie(), mass=truth.mass, rotor_x=truth.rotor_x, rotor_y=truth.rotor_y)
    heavy = changed(own, inertia=1.7 * np.asarray(truth.inertia), thrust_to_weight=2.2)
    lagging = changed(heavy, motor_time_constant=0.15, latency=0.004)
    return {"Crazyflie": crazyflie(), "mass and arm": own, "heavy, lagging": lagging}


def simulated_rows(name: str) -> Iterator[dict[str, Any]]:
    """Rows of a drone of another simulator, in shares of the truth; none without its package.

    Of three starts, the one whose value is farthest from the truth.
    """
    try:
        reality: Any = find_reality(name)
    except InputError as error:
        print(f"{name}: left out, {error}")
        return
    truth: Parameters = reality.parameters
    flights = list(record(reality, jax.random.key(0)))
    found: dict[str, list[dict[str, Any]]] = {quantity: [] for quantity in PARAMETERS}
    for label, start in starts(truth).items():
        # Logs without forces tell the inertia over mass and arm.
        arms = [float(drone.mass) * arm_length(drone) for drone in (start, truth)]
        identification = mf.identify(flights, start=start, key=jax.random.key(0))
        for quantity in PARAMETERS:
            scale = arms[0] / arms[1] if quantity.startswith("inertia") else 1.0
            value = float(component(truth, quantity)) * scale
            drone = Drone((), "", None, {quantity: (value, value)}, f"its makers; {label}")
            for row in rows_of(name, drone, identification, None):
                shares = {key: row[key] and row[key] / value for key in ("found", "low", "high")}
                found[quantity].append(row | shares | {"least": 1.0, "most": 1.0})
    for rows in found.values():
        yield max(rows, key=lambda row: (not row["inside"], abs((row["found"] or 0.0) - 1.0)))


def read_drone_flights(drone: Drone, data: Path) -> list[Flight]:
    """Flights of a drone, in the order of their files."""
    files = [file for pattern in drone.files for file in sorted(data.glob(pattern))]
    with TemporaryDirectory() as folder:
        if drone.columns:
            files = [Path(shutil.copy(file, folder)) for file in files]
            for file in files:
                file.with_suffix(".columns.toml").write_text(drone.columns)
        return [flight for file in files for flight in read_flights(file, drone=drone.start)]


def speed_share(flights: Sequence[Flight], drone: Parameters) -> float | None:
    """R^2 of measured rotor speeds by a drone's motors under the logged commands, 0.5 to 20 Hz."""
    explained = whole = 0.0
    for flight in flights:
        if flight.rotor_speed is None or flight.duration < 3:
            continue
        most = min(20.0, 0.4 / flight.period)
        band = butter(2, [2 * flight.period * hertz for hertz in (0.5, most)], "band", output="sos")
        measured, identification = (
            sosfiltfilt(band, np.nan_to_num(np.asarray(speed, float)), axis=0)
            for speed in (flight.rotor_speed, rotors(flight, drone).speed)
        )
        product = (measured * identification).sum(axis=0) ** 2 / np.maximum(
            (identification**2).sum(axis=0), 1e-12
        )
        explained, whole = explained + product.sum(), whole + (measured**2).sum()
    return float(explained / whole) if whole else None


def per_square(flights: Sequence[Flight], identification: Identification) -> np.ndarray:
    """Samples of a rotor's thrust over its squared speed, means over the flights."""
    command = np.concatenate([one.command for one in flights]).clip(0.0).astype(float)
    speeds = [one.rotor_speed for one in flights if one.rotor_speed is not None]
    linear = identification.posterior.get(
        "thrust_linear", float(identification.parameters.thrust_linear)
    )
    shares = (1 - linear) * command.mean() + linear * np.sqrt(command).mean()
    weight = float(identification.parameters.mass * identification.parameters.gravity) / 4
    square = np.mean(np.square(np.concatenate(speeds), dtype=float))
    return identification.posterior["thrust_to_weight"] * shares * weight / square


def force_by_weight(
    flights: Sequence[Flight], identification: Identification, throttle: float, volts: float
) -> np.ndarray:
    """Samples of full thrust over weight at a throttle and a battery voltage."""
    samples, drone = identification.posterior, identification.parameters
    law = thrust_law(flights, float(drone.motor_time_constant))
    speed = throttle * (volts / law.volts if law.volts else 1.0)
    linear = samples.get("thrust_linear", float(drone.thrust_linear))
    return samples["thrust_to_weight"] * ((1 - linear) * speed**2 + linear * speed)


def rows_of(
    name: str,
    drone: Drone,
    identification: Identification,
    share: float | None,
    flights: Sequence[Flight] = (),
) -> Iterator[dict[str, Any]]:
    """A row for each quantity that was measured, SI units."""
    for quantity, (least, most) in drone.truth.items():
        if quantity == TOTAL:
            samples = identification.posterior
            ratio = samples.get(SLOWING_DOWN, float(identification.parameters.spin_down_ratio))
            draws = equivalent_lag(samples[LAG], ratio) + samples["latency"]
        elif quantity == PER_SQUARE:
            draws = per_square(flights, identification)
        elif quantity in FORCES:
            draws = force_by_weight(flights, identification, *FORCES[quantity])
        else:
            draws = identification.posterior.get(quantity)
        row = {"drone": name, "quantity": quantity, "least": least, "most": most}
        row |= {"rotor_speed_r2": share, "source": drone.source}
        if draws is None:
            yield row | dict.fromkeys(("found", "low", "high", "high_over_low", "inside"))
            continue
        low, value, high = (float(end) for end in np.quantile(draws, [0.025, 0.5, 0.975]))
        needs = {TOTAL: LAG, **dict.fromkeys((PER_SQUARE, *FORCES), HOVERING)}
        is_known = needs.get(quantity, quantity) in identification.estimates
        yield row | {
            "found": value if is_known else None,
            "low": low,
            "high": high,
            "high_over_low": high / low if low > 0 else None,
            "inside": low <= most and high >= least,
        }


def real_rows(name: str, data: Path) -> Iterator[dict[str, Any]]:
    """Rows of a public drone."""
    drone, flights = DRONES[name], read_drone_flights(DRONES[name], data)
    used = [replace(one, rotor_speed=None) if drone.hide else one for one in flights]
    identification = mf.identify(used, start=drone.parameters, key=jax.random.key(0))
    yield from rows_of(
        name, drone, identification, speed_share(flights, identification.parameters), flights
    )


def lag_rows(data: Path) -> Iterator[dict[str, Any]]:
    """Lag and latency of each log and folder by measured speeds, and without them; times in ms."""
    for folder in LAG_FOLDERS:
        flights = read_flights(data / "usd" / folder).flights
        for every in EVERY:
            for log, parts in (*by_log(flights).items(), (f"{folder} together", list(flights))):
                hidden = [thinned(replace(one, rotor_speed=None), every) for one in parts]
                ends = []
                for some in (parts, hidden):
                    response = measure(Problem.of(some)).motors
                    if response is not None:
                        total = response.lag + response.latency
                        ends.append(1e3 * np.quantile(total, [0.025, 0.5, 0.975]))
                if len(ends) == 2:
                    (_, measured, _), (low, value, high) = (end.tolist() for end in ends)
                    yield {"flights": log, "every": every, "measured": measured, "found": value} | {
                        "low": low,
                        "high": high,
                        "holds": low <= measured <= high,
                    }


def _cell(row: dict[str, Any]) -> str:
    """A row of the page's table; times in ms."""
    share_of_truth = row["drone"] in SIMULATED
    is_time = row["quantity"] in (TOTAL, "motor_time_constant") and not share_of_truth
    scale = 1e3 if is_time else 1.0

    def text(key: str) -> str:
        value = row[key]
        return "" if value is None else f"{scale * float(value):.3g}"

    truth = text("least") if row["least"] == row["most"] else f"{text('least')} to {text('most')}"
    ratio = row["high_over_low"]
    share = row["rotor_speed_r2"]
    cells = [
        *(row["drone"], f"{row['quantity']}{' [ms]' if scale > 1 else ''}", truth),
        *(text("found") or "not identified", f"[{text('low')}, {text('high')}]"),
        *("" if ratio is None else f"{ratio:.2f}", "yes" if row["inside"] else "**no**"),
        *("" if share is None else f"{share:.2f}", row["source"]),
    ]
    return f"| {' | '.join(map(str, cells))} |"


def _drone(cells: str) -> str:
    return cells.removeprefix("| ").split(" | ")[0]


HEAD = """# Truth board

What `identify` finds on public drones of which something was measured, beside the measured value,
with 95 % intervals. Measured rotor speeds are hidden and only judge (R2: share of their variance
from 0.5 to 20 Hz that the identified motors predict from commands), but those of INDIflight; read,
they say 84 ms of the brushed drone.
Drones of l2f and crazyflow are recorded by our PID, 4 flights of 30 s, and identified from three
starts: the farthest from the truth, of which values are shares; their lag is that about hover, and
inertia that of the start's mass and arm. Rebuilt by
`python paper/identification/truth_board.py --data ../shared/data`.

| drone | quantity | truth | found | interval | high / low | inside | R2 of speed | truth by |
|---|---|---|---|---|---|---|---|---|
"""


def main() -> None:
    """Writes the board."""
    require_packages("pyulog", "orangebox", "pymavlink")
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder of the public logs")
    every = [*DRONES, *SIMULATED]
    parser.add_argument("--only", nargs="*", default=every, help="drones to identify again")
    parser.add_argument("--lag", action="store_true", help="add the lag of every log")
    parser.add_argument("-o", "--output", type=Path, default=Path("truth_board"))
    options = parser.parse_args()
    table = options.output / "truth_board.csv"
    rows = polars.read_csv(table).to_dicts() if table.exists() else []
    for name in options.only:
        new = list(real_rows(name, options.data) if name in DRONES else simulated_rows(name))
        if not new:
            continue
        rows = [row for row in rows if row["drone"] != name] + new
        rows.sort(key=lambda row: every.index(str(row["drone"])))
        results.write(table, polars.DataFrame(rows, infer_schema_length=None).write_csv())
        print("\n".join(map(_cell, new)), flush=True)
    cells = [_cell(row) for row in rows]
    # Drones that the output folder does not know stay on the page as they are.
    cells += [
        line
        for line in PAGE.read_text().splitlines()
        if _drone(line) in every and _drone(line) not in map(_drone, cells)
    ]
    cells.sort(key=lambda line: every.index(_drone(line)))
    PAGE.write_text(HEAD + "\n".join(cells) + "\n")
    if options.lag:
        lags = polars.DataFrame(lag_rows(options.data))
        results.write(options.output / "lags.csv", lags.write_csv())
        with polars.Config(tbl_rows=200, tbl_cols=20, tbl_hide_dataframe_shape=True):
            print(lags)


if __name__ == "__main__":
    main()
