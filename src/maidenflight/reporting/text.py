"""Numbers, symbols and units as a person reads them: ms, degrees and cm instead of SI units."""

import math
import re
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup, escape

from maidenflight.parameters import COMPONENTS, QUANTITIES, Quantity, part_names

NOTHING = "\N{EN DASH}"
"""Stands for a number that is not known."""


class DisplayFormat(NamedTuple):
    """Display of a quantity: its name, displayed value per SI value, and unit."""

    name: str
    scale: float
    unit: str


ERRORS = {
    "position": DisplayFormat("position", 100.0, "cm"),
    "velocity": DisplayFormat("velocity", 1.0, "m/s"),
    "attitude": DisplayFormat("attitude", math.degrees(1.0), "°"),
    "body_rates": DisplayFormat("body rates", 1.0, "rad/s"),
}
"""Display of prediction errors, in tables, pictures and terminals."""

_LABELS = {
    "thrust_to_weight": "thrust-to-weight ratio",
    "torque_to_thrust": "torque-to-thrust ratio",
    "spin_down_ratio": "spin-down ratio",
}
"""Of names that are no words with blanks between them."""
_GREEK = {
    "Delta": "Δ",
    "sigma": "\N{GREEK SMALL LETTER SIGMA}",
    "theta": "θ",
    "tau": "τ",
    "phi": "φ",
    "omega": "ω",
    "Omega": "Ω",
}
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def symbol(name: str) -> Markup:
    """Returns a parameter's symbol as HTML: of `T_m` T with a subscript."""
    letters = "|".join(_GREEK)
    field, index = COMPONENTS.get(name, (name, None))
    quantity = QUANTITIES[field]
    part = "" if index is None else f"_{part_names(quantity.size)[index]}"
    symbol_text = quantity.symbol + part
    greek = re.sub(rf"(?<![a-z])({letters})(?![a-z])", lambda match: _GREEK[match[0]], symbol_text)
    return Markup(re.sub(r"_(\w+)", r"<sub>\1</sub>", str(escape(greek))))


def label(name: str) -> str:
    """Returns a parameter, or a group of them, in words: the one name of everything for people."""
    return _LABELS.get(name, name.replace("_", " "))


def plain_symbol(name: str) -> str:
    """Returns a parameter's symbol where nothing can be lowered: `T_m`, `I_x`, `τ`."""
    return Markup(str(symbol(name)).replace("<sub>", "_")).striptags()


def quantity(name: str) -> Quantity:
    """Returns the quantity of a parameter, or of the vector of a component such as `inertia_x`."""
    return QUANTITIES[COMPONENTS.get(name, (name, None))[0]]


def scale(name: str, values: Any) -> tuple[float, str]:
    """Chooses the power of ten of displayed values, and the unit with it."""
    if factor(name) != 1.0:
        return factor(name), unit(name)
    largest, power = float(np.max(np.abs(values), initial=0.0)), 0
    if largest > 0 and not 0.05 <= largest < 1e4:
        power = 3 * math.floor(math.log10(largest) / 3)
    power_text = "10" + str(power).translate(_RAISED) if power else ""
    return 10.0**-power, f"{power_text} {unit(name)}".strip()


def factor(name: str) -> float:
    """Returns the displayed value per SI value: 1000 for short times, in ms."""
    parameter = quantity(name)
    return 1000.0 if parameter.unit == "s" and parameter.upper <= 1.0 else 1.0


def unit(name: str) -> str:
    """Returns the display unit of a parameter; empty for a pure number."""
    if factor(name) != 1.0:
        return "ms"
    unit_text = quantity(name).unit.replace("sqrt(Hz)", "√Hz")
    return "" if unit_text == "-" else re.sub(r"(?<=[a-z])2", "²", unit_text)


def places(width: float) -> int:
    """Decimals at which a number of this uncertainty keeps two digits of it."""
    return min(6, max(0, 1 - math.floor(math.log10(width)))) if width > 0 else 4


def rounding(name: str, low: float, high: float) -> tuple[float, int, str]:
    """Returns factor, decimals and unit that show two digits of an interval's width."""
    factor, unit = scale(name, [low, high])
    return factor, places(factor * (high - low)), unit


def fixed(value: float, digits: int) -> str:
    """Returns a number with so many decimals."""
    return signed(f"{value:z.{digits}f}")


def signed(number_text: str) -> str:
    """Returns a written number with a minus that is as wide as a plus."""
    return number_text.replace("-", "\N{MINUS SIGN}")


def with_error(value: float, error: float | None) -> tuple[str, str]:
    """Returns a difference with its sign, and its standard error; `unknown` if that is not known.

    Both have two digits of the error, from four to nine decimals.
    """
    decimals = min(9, max(4, 1 - math.floor(math.log10(error)))) if error else 4
    return f"{value:+.{decimals}f}", "unknown" if error is None else f"{error:.{decimals}f}"


def number(value: Any, digits: int = 4) -> str:
    """Returns a number in few digits, without trailing zeros."""
    value = float(value)
    if not math.isfinite(value):
        return NOTHING
    mantissa_text = f"{value:.{digits}g}"
    if "e" in mantissa_text:
        mantissa, exponent = mantissa_text.split("e")
        power = str(int(exponent)).translate(_RAISED)
        mantissa_text = f"{mantissa} \N{MULTIPLICATION SIGN} 10{power}"
    return signed(mantissa_text)


def plural(count: int, noun: str) -> str:
    """Counts things in words: `1 flight`, `2 flights`, `3 policies`."""
    if count == 1:
        return f"1 {noun}"
    return f"{count} {noun[:-1]}ies" if noun.endswith("y") else f"{count} {noun}s"
