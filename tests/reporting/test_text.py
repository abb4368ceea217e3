"""Numbers, symbols and units read well."""

import pytest

from maidenflight.reporting import text


def test_symbols_units_and_numbers_read_well():
    assert text.symbol("motor_time_constant") == "T<sub>m</sub>"
    assert text.symbol("gyro_noise") == "\N{GREEK SMALL LETTER SIGMA}<sub>ω</sub>"
    assert text.unit("latency") == "ms"
    assert text.unit("gyro_bias_time") == "s"
    assert text.unit("inertia") == "kg m²"
    assert text.number(1.33e-5) == "1.33 \N{MULTIPLICATION SIGN} 10⁻⁵"
    assert text.number(-2.5) == "\N{MINUS SIGN}2.5"
    assert text.number(float("nan")) == text.NOTHING
    assert [text.fixed(one, 0) for one in (-0.4, -1.0)] == ["0", "\N{MINUS SIGN}1"]


def test_components_have_symbols_and_units_with_powers():
    assert text.symbol("inertia_x") == "I<sub>x</sub>"
    assert text.scale("inertia_x", [1.33e-5]) == (pytest.approx(1e6), "10⁻⁶ kg m²")
    assert text.scale("latency", [0.018]) == (1000.0, "ms")
    assert text.scale("thrust_to_weight", [1.7]) == (1.0, "")


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (0.098, 0.0054, ("+0.0980", "0.0054")),
        (-3.1e-6, 4.3e-7, ("-0.00000310", "0.00000043")),
        (0.0, 0.0, ("+0.0000", "0.0000")),
        (0.0018, 1e-4, ("+0.00180", "0.00010")),
        (0.01, 1e-19, ("+0.010000000", "0.000000000")),
        (0.0018, None, ("+0.0018", "unknown")),
    ],
)
def test_a_gain_has_two_digits_of_its_standard_error(value, error, shown):
    assert text.with_error(value, error) == shown
