"""Output of identified drones: parameters, how they were found, and how well they predict."""

import math
from collections.abc import Mapping
from textwrap import fill
from typing import TYPE_CHECKING

from maidenflight.terminal import table

if TYPE_CHECKING:
    from polars import DataFrame

    from maidenflight.identification.closed_loop import Match
    from maidenflight.identification.estimates import Identification

_IN_MS = ("motor_time_constant", "latency")
"""Parameters whose truth is given in milliseconds, as text."""


def estimates(found: "Identification", truth: dict[str, str] | None = None) -> None:
    """Prints identified parameters, beside the truth where it is known."""
    replayed = found.objective == "replay"
    rows: list[list[str]] = []
    for name, estimate in found.estimates.items():
        scale, unit = _scale(name, estimate.value)

        def shown(number: float, scale: float = scale) -> str:
            return f"{number * scale:.4g}"

        row = [
            name,
            shown(estimate.value),
            f"{shown(estimate.interval[0])} .. {shown(estimate.interval[1])}",
            f"{float(f'{estimate.between_sd * scale:.2g}'):g}",
        ]
        if replayed:
            row.append(
                ""
                if estimate.valley is None
                else f"{shown(estimate.valley[0])} .. {shown(estimate.valley[1])}"
            )
            row.append(
                f"{float(f'{estimate.trial_sd * scale:.2g}'):g}" if len(estimate.trials) > 1 else ""
            )
        if truth is not None:
            row.append(truth.get(name, "") if name in _IN_MS else shown(float(truth[name])))
        rows.append([*row, unit])
    further = [
        *(["range within\n1 %", "between\ntrials"] if replayed else []),
        *(["truth"] if truth is not None else []),
    ]
    table(
        "Identified parameters",
        ["parameter", "value", "95 % interval", "between\nflights", *further, "unit"],
        rows,
    )
    print("between flights, or segments of them: standard deviation; the next may be as far off")
    if replayed:
        print("between trials: standard deviation, of the optimiser only")


def matched(found: "Match", flights: int) -> None:
    """Prints what a comparison of closed loops found, of so many flights."""
    from maidenflight.identification.behaviour import BEHAVIOUR

    rows = []
    for name, (value, error) in found.found.items():
        scale, unit = _scale(name, value)
        low, high = max(value - 1.96 * error, 0.0), value + 1.96 * error
        interval = f"{low * scale:.4g} .. {high * scale:.4g}"
        rows.append([name, f"{value * scale:.4g}", interval, unit])
    table("Parameters of the closed loop", ["parameter", "value", "95 % interval", "unit"], rows)
    table(
        "Standard deviations, simulated over logged, median of the policies",
        ["of", "before", "after"],
        [
            [name, f"{math.exp(before):.2f}", f"{math.exp(after):.2f}"]
            for name, before, after in zip(BEHAVIOUR, found.before, found.after, strict=True)
        ],
    )
    print(f"{found.flights} of {flights} flights, of {found.policies} policies, were compared")


def untold(found: "Identification") -> None:
    """Prints what the flights could not tell, with the ranges that are plausible."""
    if not found.unidentified:
        return
    ranges = []
    for name, (low, high) in found.unidentified.items():
        scale, unit = _scale(name, high)
        ranges.append(f"{name} {low * scale:.3g} .. {high * scale:.3g} {unit}".strip())
    said = (
        f"not identifiable from these flights: {', '.join(ranges)}. That is what is plausible; "
        "start values are kept, and training with --randomize posterior covers these ranges."
    )
    print(fill(said, 118))


def _scale(name: str, value: float) -> tuple[float, str]:
    """Shown value per SI value, and the unit in which it is shown."""
    from maidenflight.parameters import COMPONENTS, QUANTITIES

    unit = QUANTITIES[COMPONENTS[name][0]].unit
    unit = "" if unit == "-" else unit
    if unit == "s":
        return 1e3, "ms"
    return (1e6, f"1e-6 {unit}".strip()) if 0.0 < abs(value) < 1e-3 else (1.0, unit)


def kept(found: "Identification", start: str) -> None:
    """Prints what identified parameters rest on, and the noise found."""
    from maidenflight.parameters import COMPONENTS, GEOMETRY, QUANTITIES, arm_length

    mass, arm = float(found.parameters.mass), arm_length(found.parameters)
    if not {"mass", *GEOMETRY} & {COMPONENTS[name][0] for name in found.estimates}:
        print(
            f"kept from {start}: mass {mass * 1e3:.4g} g and rotors {arm * 1e3:.4g} mm from the "
            "centre, on which inertias and torques depend;"
        )
        print("if yours differ, give --mass, or your drone with --start.")
    if found.noise:
        levels = (
            f"{name} {value:.3g} {QUANTITIES[name].unit}".removesuffix(" -")
            for name, value in found.noise.items()
            if value
        )
        print(fill(f"noise found: {', '.join(levels)}", 118))


def reached_objective(found: "Identification", start: str) -> None:
    """Prints how well the identified drone fits, beside the one that the search began with."""
    if found.objective == "replay":
        fit = (
            f"mean error of a replayed window {found.value:.4g} "
            f"({found.start_value:.4g} for {start})"
        )
    else:
        fit = (
            f"log-likelihood {-found.value:.4g} nats a row ({-found.start_value:.4g} "
            f"for {start}; more is better)"
        )
    print(f"{fit}, after {found.evaluations} evaluations of it in {found.seconds:.1f} s")


def gains(found: "Identification") -> None:
    """Prints the log-likelihood gain of each group of parameters, where the flights chose them."""
    if not found.gains:
        return
    from maidenflight.reporting.text import with_error

    rows = [
        [
            group.group,
            *with_error(group.log_likelihood_gain, group.standard_error),
            "kept" if group.kept else "not kept",
        ]
        for group in found.gains
    ]
    heads = ["parameters", "gain a row\n(nats)", "standard\nerror", ""]
    table("Log-likelihood gain on held-out flights", heads, rows)
    if any(group.standard_error is None for group in found.gains):
        print("unknown: one held-out segment of flight gives no standard error; give more flights.")


def log_likelihoods(found: Mapping[str, float]) -> None:
    """Prints the log likelihood of a row by drone."""
    rows = [[name, f"{value:.2f}"] for name, value in found.items()]
    heads = ["drone", "log likelihood\nnats a row"]
    table("Likelihood of each row given the rows before, more is better", heads, rows, 1)


def predictions(errors: "DataFrame", simulated: bool) -> None:
    """Prints prediction errors, a block of rows for each horizon.

    `*` marks what is worse than the persistence baseline.
    """
    from maidenflight.identification.prediction import PERSISTENCE
    from maidenflight.reporting.text import ERRORS

    baseline = {
        row["horizon"]: row for row in errors.iter_rows(named=True) if row["model"] == PERSISTENCE
    }
    rows: list[list[str]] = []
    for row in errors.iter_rows(named=True):
        worse = {name: not row[name] <= baseline[row["horizon"]][name] for name in ERRORS}
        cells = [
            f"{'* ' if worse[name] else ''}{row[name] * scale:#.3g}"
            for name, (_, scale, _) in ERRORS.items()
        ]
        first = row["model"] == errors["model"][0]
        rows.append(
            [
                f"{row['horizon']:g} s" if first else "",
                row["model"],
                *(cell.removesuffix(".") for cell in cells),
            ]
        )
    heads = [f"{name}\n{unit}" for name, _, unit in ERRORS.values()]
    title = (
        f"Open-loop prediction errors on {'simulated' if simulated else 'real'} flight, root "
        "mean squares"
    )
    table(title, ["ahead", "model", *heads], rows, numbers_from=2)
    if any(cell.startswith("*") for row in rows for cell in row[2:]):
        print(f"* worse than the baseline, {PERSISTENCE}")
