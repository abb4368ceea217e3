"""A planted drone hovers, and its log has the rates of PX4's default profile."""

import numpy as np
import pytest

from scripts import script

planted_px4 = script("planted_px4")


@pytest.fixture(scope="module")
def signals():
    generator = np.random.default_rng(5)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(planted_px4, "SECONDS", 6.0)
        return planted_px4.fly(planted_px4.draw_drone(generator), generator)


@pytest.mark.slow
def test_a_planted_drone_hovers(signals) -> None:
    assert signals.force[800:, 2].mean() == pytest.approx(-planted_px4.GRAVITY, rel=0.05)
    assert np.abs(signals.rates).max() < 6.0
    assert np.all((signals.motors > 0.05) & (signals.motors < 0.99))


@pytest.mark.slow
def test_its_log_has_the_default_profiles_rates(signals) -> None:
    topics = planted_px4.topics_of(signals)
    expected = {"sensor_combined": 200, "vehicle_torque_setpoint": 50, "actuator_motors": 10}
    for name, rate in expected.items():
        stamps = topics[name]["timestamp"]
        assert 1e6 / np.diff(stamps).mean() == pytest.approx(rate, rel=1e-3), name
