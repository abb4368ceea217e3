"""An optimiser of your own for identification: Nelder and Mead's simplex on the likelihood.

Run with `python examples/own_optimiser.py`. What `mf.identify` adds are noise, intervals and the
choice of parameters.
"""

from dataclasses import replace

import jax
import numpy as np
from scipy.optimize import minimize

import maidenflight as mf

NAMES, FIRST = ("motor_time_constant", "latency"), np.array([0.05, 0.01])
"""What is fitted, and where the search begins [s]."""


def fit(flights, start, evaluations=60):
    """Returns the parameters at which the logs are most likely."""

    def drone(logarithms):
        lag, latency = np.array(FIRST * np.exp(logarithms), np.float32)
        return replace(start, motor_time_constant=lag, latency=latency)

    options = {"maxfev": evaluations}
    best = minimize(
        lambda logarithms: -mf.log_likelihood(flights, drone(logarithms)),
        np.zeros(len(NAMES)),
        method="Nelder-Mead",
        options=options,
    )
    return drone(best.x)


if __name__ == "__main__":
    truth = mf.virtual_drone(7)
    flights = mf.record(truth, jax.random.key(0), flights=2, duration=6.0)
    best = fit(flights, truth.parameters)
    for name in NAMES:
        print(name, float(getattr(best, name)), "truth", float(getattr(truth.parameters, name)))
