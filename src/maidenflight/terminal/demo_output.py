"""Output of the demo: what it found, beside what is true of its virtual drone."""

from typing import TYPE_CHECKING

from maidenflight.terminal.drone_output import estimates, untold
from maidenflight.terminal.flight_output import flights

if TYPE_CHECKING:
    from maidenflight.demo import Demo


def truth(result: "Demo") -> dict[str, str]:
    """The true parameters of the demo's virtual drone as text; it has two delays, the model one."""
    from maidenflight.parameters import component

    hidden = result.truth
    latency, late = (
        float(hidden.latency) * 1e3,
        float(hidden.estimator_delay + hidden.gyro_time_constant) * 1e3,
    )
    plain = {
        name: f"{float(component(hidden, name)):.4g}" for name in result.identification.estimates
    }
    if "motor_time_constant" in plain:
        plain["motor_time_constant"] = f"{float(hidden.motor_time_constant) * 1e3:.4g}"
    if "latency" in plain:
        plain["latency"] = f"{latency:.2g} + {late:.2g} sensors"
    return plain


def _both_lags(result: "Demo", truth: dict[str, str]) -> dict[str, str]:
    """The truth with the lag while slowing down too, where one lag was identified."""
    lag = float(result.truth.motor_time_constant * result.truth.spin_down_ratio) * 1e3
    if "motor_time_constant" not in truth or "spin_down_ratio" in truth:
        return truth
    return truth | {"motor_time_constant": f"{truth['motor_time_constant']}, slowing {lag:.4g}"}


def summary(result: "Demo") -> None:
    """Prints what the demo found and where it wrote it."""
    from maidenflight.demo import reached

    table = result.transfer.table
    estimates(result.identification, _both_lags(result, truth(result)))
    untold(result.identification)
    print(
        "Intervals show how much values depend on these flights, not on the model: the truth may "
        "lie outside where this drone has"
    )
    print("what the model lacks, such as late sensors and a battery that sags.")
    flights(result.transfer)
    durations, errors = table["duration"], table["position_error"]
    print(
        f"{reached(table)} of {table.height} flights reached the time limit; median "
        f"{durations.median():.1f} s,",
        end=" ",
    )
    print(
        f"mean position error {float(errors.to_numpy().mean()) * 100:.1f} cm. Flights and drone "
        "are simulated."
    )
    print(
        "wall time: "
        + ", ".join(f"{name} {seconds:.0f} s" for name, seconds in result.seconds.items())
    )
    folder = result.folder
    print(
        f"\n  drone      {folder / 'drone.toml'}\n  policies   {folder / 'policies'}/\n  flights  "
        f"  {folder / 'transfer'}/"
    )
    print(f"  C code     {folder / 'firmware'}/    <- of the best policy, {result.best.stem}")
    print(f"  report     {result.page}    <- open this in a browser")
