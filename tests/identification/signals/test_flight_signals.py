"""Commands that come late."""

import numpy as np
import pytest

from maidenflight.identification.signals.flight_signals import delay_command

COMMAND = np.random.default_rng(0).uniform(0.3, 0.9, (40, 4))


@pytest.mark.parametrize("rows", [0.0, 2.0, 2.3])
def test_late_commands_are_means_over_rows_of_the_commands_that_arrive(rows: float) -> None:
    fine = np.repeat(COMMAND, 10, axis=0)
    late = np.concatenate([np.repeat(fine[:1], round(10 * rows), axis=0), fine])[: len(fine)]
    np.testing.assert_allclose(delay_command(COMMAND, rows), late.reshape(-1, 10, 4).mean(axis=1))
