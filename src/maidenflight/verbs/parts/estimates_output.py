"""Output of identified parameters, and of how well they fit."""

from collections.abc import Mapping, Sequence
from typing import Any

from maidenflight.identification.outcome.estimates import Identification
from maidenflight.identification.outcome.plausible import HOVERING
from maidenflight.identification.signals.lag import LAG
from maidenflight.identification.uncertainty import DELAY, agreements
from maidenflight.parameters import COMPONENTS, GEOMETRY, QUANTITIES, arm_length, component
from maidenflight.reporting.text import with_error
from maidenflight.terminal import Table
from maidenflight.verbs.parts.logs_output import scale_of

_MAIN = ("thrust_to_weight", "motor_time_constant", "latency")
"""The parameters of the paper."""
_LEGEND = (
    "start's: not identified, the value of --start stays; usual: what drones have, with which the "
    "lag is told"
)
_DISAGREES = 1e-3
"""Chance below which signals are said to disagree, chosen so that of a hundred tables with ten
parameters of several signals one says so by chance."""


def tabulate_estimates(
    result: Identification, truth: Mapping[str, str | float] | None = None
) -> list[Table | str]:
    """Returns identified parameters, beside the truth where it is known.

    Args:
        result: the result.
        truth: by parameter, in SI units, or as text in the display unit.
    """
    replayed = result.objective == "replay"
    rows: list[dict[str, Any]] = []
    for name in (*result.estimates, *result.unidentified):
        estimate, ends = result.estimates.get(name), result.unidentified.get(name, (0.0, 0.0))
        scale, unit = scale_of(name, estimate.value if estimate else ends[1])
        true = (truth or {}).get(name, "")
        row = {"name": name, "unit": unit, "valley": "", "between": "", "trials": ""}
        row["truth"] = true if isinstance(true, str) else f"{true * scale:.4g}"
        if estimate is None:
            value = f"{float(component(result.parameters, name)) * scale:.4g}"
            # A latency that is not told apart goes with the lag that is.
            follows = name == "latency" and LAG in result.estimates
            row["value"] = f"usual {value}" if follows else f"start's {value}"
            row["interval"] = f"{_range(ends, scale)} (plausible)"
        else:
            row["value"] = f"{estimate.value * scale:.4g}"
            row["interval"] = _range(estimate.interval, scale)
            row["valley"] = _range(estimate.valley, scale) if estimate.valley else ""
            row["between"] = _two_digits(estimate.between_sd * scale)
            row["trials"] = _two_digits(estimate.trial_sd * scale) if estimate.trials[1:] else ""
        rows.append(row)
    columns = {"parameter": "{name}", "value": "{value}", "95 % interval": "{interval}"}
    columns |= {"between\nflights": "{between}"}
    columns |= {"range within\n1 %": "{valley}", "between\ntrials": "{trials}"} if replayed else {}
    columns |= {"truth": "{truth}"} if truth is not None else {}
    return [
        Table("Identified parameters", columns | {"unit": "{unit}"}, rows, tuple(columns)[:2:-1]),
        "between flights: standard deviation from one flight, or segment of it, to the next",
        *([_LEGEND] if result.unidentified else []),
        *(["between trials: standard deviation, of the optimiser only"] if replayed else []),
    ]


def _range(ends: tuple[float, float], scale: float) -> str:
    return " .. ".join(f"{end * scale:.4g}" for end in ends)


def _two_digits(value: float) -> str:
    """Returns two digits of a number, without an exponent."""
    return f"{float(f'{value:.2g}'):g}"


def summarize(result: Identification, settings: Sequence[str] = ()) -> list[str]:
    """Returns a line on what was identified, one on what was not, and what to fly next.

    Args:
        result: of the identification.
        settings: what to set on autopilots that recorded the logs, which take no plan.
    """
    names = list(result.estimates)
    main = [name for name in _MAIN if name in names] or names[: len(_MAIN)]
    values = []
    for name in main:
        estimate = result.estimates[name]
        scale, unit = scale_of(name, estimate.value)
        low, high = (f"{end * scale:.3g}" for end in estimate.interval)
        values.append(f"{name} {estimate.value * scale:.3g} [{low}, {high}] {unit}".rstrip())
    rest = len(names) - len(main)
    more = f" and {rest} more" if rest else ""
    flights = f"{result.source.flights} flight{'s' * (result.source.flights > 1)}"
    left_out = ", ".join(result.unidentified)
    return [
        f"identified: {', '.join(values)}{more}, from {flights}, {result.source.seconds:.0f} s",
        f"not identified: {left_out}, no more than before these flights; training with --randomize "
        "posterior covers the plausible ranges"
        if left_out
        else "not identified: nothing; the flights determine every parameter that was fitted",
        *_name_advice(result, settings),
        *_describe_thrust(result),
    ]


def _name_advice(result: Identification, settings: Sequence[str]) -> list[str]:
    """Returns what to log or fly for narrower intervals, and how this autopilot logs it."""
    actions: dict[str, list[str]] = {}
    for tip in result.advice:
        actions.setdefault(tip.action, []).append(tip.parameter)
    text = "; ".join(f"{action} ({', '.join(names)})" for action, names in actions.items())
    if not actions:
        return []
    if not settings:
        return [f"to narrow them: {text}; or maidenflight plan"]
    logs = any(action.startswith("log ") for action in actions)
    return [
        f"to narrow them, by hand in one flight: {text}",
        *(f"to log it so, {setting}" for setting in settings if logs),
    ]


def describe_advice(result: Identification) -> list[str]:
    """Returns a line for each parameter that another flight narrows, with the interval then."""
    lines = []
    for tip in result.advice:
        estimate = result.estimates.get(tip.parameter)
        now = result.unidentified[tip.parameter] if estimate is None else estimate.interval
        scale, unit = scale_of(tip.parameter, now[1])
        line = f"narrow {tip.parameter}, {_range(now, scale)} {unit}".rstrip()
        expected = "" if tip.interval is None else f"; expect {_range(tip.interval, scale)}"
        lines.append(f"{line}: {tip.action}{expected}")
    return lines


def _describe_thrust(result: Identification) -> list[str]:
    """Returns the full thrust, by which alone a wrong scale of real commands shows."""
    if HOVERING not in result.estimates or result.source.simulated:
        return []
    drone = result.parameters
    weight = float(drone.mass * drone.gravity)
    full = weight * float(drone.thrust_to_weight)
    low, high = (weight * end for end in result.estimates[HOVERING].interval)
    return [
        f"compare: full thrust {full:.3g} N [{low:.3g}, {high:.3g}], {full / 4:.3g} N a motor; a "
        "wrong scale of commands shows nowhere else"
    ]


def tabulate_evidence(result: Identification) -> list[Table | str]:
    """Returns what each signal says by itself, and how far signals agree."""
    if not result.evidence:
        return []
    agree, rows = agreements(result.evidence), []
    order = {name: number for number, name in enumerate(COMPONENTS)}
    last = ""
    for entry in sorted(result.evidence, key=lambda entry: order.get(entry.parameter, -1)):
        is_delay = entry.parameter == DELAY
        scale, unit = (1e3, "ms") if is_delay else scale_of(entry.parameter, entry.value)
        row = {"name": "", "agree": "", "signal": entry.signal, "unit": unit}
        if entry.parameter != last:
            last = row["name"] = entry.parameter
            if last in agree:
                chance, degrees = agree[last].chance, agree[last].degrees
                verdict = "" if chance > _DISAGREES else " *"
                row["agree"] = f"{agree[last].chi_square:.2g} of {degrees}{verdict}"
        row |= {"value": f"{entry.value * scale:.4g}", "error": _two_digits(entry.error * scale)}
        rows.append(row)
    columns = {"parameter": "{name}", "signal": "{signal}", "value": "{value}"}
    columns |= {"error": "{error}", "unit": "{unit}", "chi-square": "{agree}"}
    return [
        Table("What each signal says by itself", columns, rows),
        "error: standard; chi-square of signals about their mean, of its degrees of freedom; *: "
        "they disagree, leave one out with --ignore",
    ]


def tabulate_gains(result: Identification) -> list[Table | str]:
    """Returns the log-likelihood gain of each group of parameters, where the flights chose them."""
    if not result.gains:
        return []
    rows = []
    for group in result.gains:
        gain, error = with_error(group.log_likelihood_gain, group.standard_error)
        verdict = "kept" if group.is_in_model else f"not kept: {group.reason or 'unknown'}"
        rows.append({"group": group.group, "gain": gain, "error": error, "kept": verdict})
    columns = {"parameters": "{group}", "gain a row\n(nats)": "{gain}"}
    columns |= {"standard\nerror": "{error}", "": "{kept}"}
    unknown = any(group.standard_error is None for group in result.gains)
    note = "unknown: one held-out segment of flight gives no standard error; give more flights."
    return [
        Table("Log-likelihood gain on held-out flights", columns, rows),
        *([note] if unknown else []),
    ]


def describe_fit(result: Identification, start: str) -> list[str]:
    """Returns what estimates rest on, the noise, and the fit beside that of the start."""
    lines = []
    if not {"mass", *GEOMETRY} & {COMPONENTS[name][0] for name in result.estimates}:
        mass, arm = float(result.parameters.mass), arm_length(result.parameters)
        lines += [
            f"taken from {start}: mass {mass * 1e3:.4g} g and rotors {arm * 1e3:.4g} mm from the "
            "centre, on which inertias and torques depend;",
            "if yours differ, give --mass, or your drone with --start.",
        ]
    if result.noise:
        levels = (
            f"{name} {value:.3g} {QUANTITIES[name].unit}".removesuffix(" -")
            for name, value in result.noise.items()
            if value
        )
        lines.append(f"noise: {', '.join(levels)}")
    fit = (
        f"mean error of a replayed window {result.value:.4g} ({result.start_value:.4g} for {start})"
        if result.objective == "replay"
        else f"log-likelihood {-result.value:.4g} nats a row ({-result.start_value:.4g} for {start}"
        "; more is better)"
    )
    return [
        *lines,
        f"{fit}, after {result.evaluations} evaluations of it in {result.seconds:.1f} s",
    ]
