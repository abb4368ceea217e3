"""A training that is small, and the same in many tests: with three policies, on the circle and by
PWM, its program is compiled once and then read from the cache."""

from maidenflight.training.analytic_gradient import AnalyticGradient

QUICK = AnalyticGradient(
    updates=2, evaluations=1, num_envs=4, horizon=4, episodes=4, hidden_learning_rate=0.0
)
