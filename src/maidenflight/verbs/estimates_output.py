"""Output of identified parameters, and of how well they fit."""

from collections.abc import Mapping
from textwrap import fill
from typing import TYPE_CHECKING

from maidenflight import terminal
from maidenflight.verbs.logs import scale_of

if TYPE_CHECKING:
    from maidenflight.identification.outcome.estimates import Identification


def show_estimates(found: "Identification", truth: Mapping[str, str | float] | None = None) -> None:
    """Prints identified parameters, beside the truth where it is known.

    Args:
        found: the identification.
        truth: by parameter, in SI units, or as text in the unit that is shown.
    """
    replayed = found.objective == "replay"
    rows: list[list[str]] = []
    for name, estimate in found.estimates.items():
        scale, unit = scale_of(name, estimate.value)
        low, high = (f"{end * scale:.4g}" for end in estimate.interval)
        row = [name, f"{estimate.value * scale:.4g}", f"{low} .. {high}"]
        row.append(f"{float(f'{estimate.between_sd * scale:.2g}'):g}")
        if replayed:
            valley = [f"{end * scale:.4g}" for end in estimate.valley or ()]
            several = len(estimate.trials) > 1
            row.append(" .. ".join(valley))
            row.append(f"{float(f'{estimate.trial_sd * scale:.2g}'):g}" if several else "")
        if truth is not None:
            true = truth.get(name, "")
            row.append(true if isinstance(true, str) else f"{true * scale:.4g}")
        rows.append([*row, unit])
    columns = ["parameter", "value", "95 % interval", "between\nflights"]
    columns += ["range within\n1 %", "between\ntrials"] if replayed else []
    columns += ["truth"] if truth is not None else []
    terminal.print_table("Identified parameters", [*columns, "unit"], rows)
    print("between flights, or segments of them: standard deviation; the next may be as far off")
    if replayed:
        print("between trials: standard deviation, of the optimiser only")


def show_unidentifiable(found: "Identification") -> None:
    """Prints what the flights do not determine, with the ranges that are plausible."""
    ranges = []
    for name, (low, high) in found.unidentified.items():
        scale, unit = scale_of(name, high)
        ranges.append(f"{name} {low * scale:.3g} .. {high * scale:.3g} {unit}".strip())
    if ranges:
        text = (
            f"not identifiable from these flights: {', '.join(ranges)}. That is what is plausible; "
            "start values are kept, and training with --randomize posterior covers these ranges."
        )
        print(fill(text, 118))


def show_gains(found: "Identification") -> None:
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
    columns = ["parameters", "gain a row\n(nats)", "standard\nerror", ""]
    terminal.print_table("Log-likelihood gain on held-out flights", columns, rows)
    if any(group.standard_error is None for group in found.gains):
        print("unknown: one held-out segment of flight gives no standard error; give more flights.")


def show_fit(found: "Identification", start: str) -> None:
    """Prints what estimates rest on, the noise, and the fit beside that of the start."""
    from maidenflight.parameters import COMPONENTS, GEOMETRY, QUANTITIES, arm_length

    mass, arm = float(found.parameters.mass), arm_length(found.parameters)
    if not {"mass", *GEOMETRY} & {COMPONENTS[name][0] for name in found.estimates}:
        print(
            f"kept from {start}: mass {mass * 1e3:.4g} g and rotors {arm * 1e3:.4g} mm from the "
            "centre, on which inertias and torques depend;"
        )
        print("if yours differ, give --mass, or your drone with --start.")
    levels = (
        f"{name} {value:.3g} {QUANTITIES[name].unit}".removesuffix(" -")
        for name, value in found.noise.items()
        if value
    )
    if found.noise:
        print(fill(f"noise found: {', '.join(levels)}", 118))
    fit = (
        f"mean error of a replayed window {found.value:.4g} ({found.start_value:.4g} for {start})"
        if found.objective == "replay"
        else f"log-likelihood {-found.value:.4g} nats a row ({-found.start_value:.4g} for {start}; "
        "more is better)"
    )
    print(f"{fit}, after {found.evaluations} evaluations of it in {found.seconds:.1f} s")
