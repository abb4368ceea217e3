"""maidenflight: from flight logs to a neural network that flies the real drone on its first try."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from maidenflight.deployment.c import export_c as export_c
    from maidenflight.experiments.flight_times import predict_flight_times as predict_flight_times
    from maidenflight.experiments.transfer import transfer as transfer
    from maidenflight.flights.log import Flight as Flight
    from maidenflight.flights.reading import read_flights as read_flights
    from maidenflight.flights.recording import record as record
    from maidenflight.identification.identify import identify as identify
    from maidenflight.identification.prediction import prediction_error as prediction_error
    from maidenflight.parameters import Parameters as Parameters
    from maidenflight.parameters import crazyflie as crazyflie
    from maidenflight.policy import Policy as Policy
    from maidenflight.reporting.page import report as report
    from maidenflight.simulator.control import attitude as attitude
    from maidenflight.simulator.control import attitude_rate as attitude_rate
    from maidenflight.simulator.control import pwm as pwm
    from maidenflight.simulator.environment import Environment as Environment
    from maidenflight.simulator.environment import reset as reset
    from maidenflight.simulator.environment import step as step
    from maidenflight.simulator.randomization import randomize as randomize
    from maidenflight.simulator.randomization import relative_box as relative_box
    from maidenflight.simulator.randomization import wide_box as wide_box
    from maidenflight.simulator.rollout import rollout as rollout
    from maidenflight.simulator.tasks import circle as circle
    from maidenflight.simulator.tasks import figure_eight as figure_eight
    from maidenflight.simulator.tasks import hover as hover
    from maidenflight.simulator.tasks import take_off as take_off
    from maidenflight.simulator.tasks import tracking as tracking
    from maidenflight.simulator.virtual_drone import VirtualDrone as VirtualDrone
    from maidenflight.simulator.virtual_drone import virtual_drone as virtual_drone
    from maidenflight.training.analytic_gradient import AnalyticGradient as AnalyticGradient
    from maidenflight.training.evaluation import evaluate as evaluate
    from maidenflight.training.ppo import PPO as PPO
    from maidenflight.training.train import train as train

# Each public name lives in one module, which is imported when the name is first used: `import
# maidenflight` costs no JAX.
_PUBLIC = {
    "AnalyticGradient": "training.analytic_gradient",
    "Environment": "simulator.environment",
    "Flight": "flights.log",
    "PPO": "training.ppo",
    "Parameters": "parameters",
    "Policy": "policy",
    "VirtualDrone": "simulator.virtual_drone",
    "attitude": "simulator.control",
    "attitude_rate": "simulator.control",
    "circle": "simulator.tasks",
    "crazyflie": "parameters",
    "evaluate": "training.evaluation",
    "export_c": "deployment.c",
    "figure_eight": "simulator.tasks",
    "hover": "simulator.tasks",
    "identify": "identification.identify",
    "predict_flight_times": "experiments.flight_times",
    "prediction_error": "identification.prediction",
    "pwm": "simulator.control",
    "randomize": "simulator.randomization",
    "read_flights": "flights.reading",
    "record": "flights.recording",
    "relative_box": "simulator.randomization",
    "report": "reporting.page",
    "reset": "simulator.environment",
    "rollout": "simulator.rollout",
    "step": "simulator.environment",
    "take_off": "simulator.tasks",
    "tracking": "simulator.tasks",
    "train": "training.train",
    "transfer": "experiments.transfer",
    "virtual_drone": "simulator.virtual_drone",
    "wide_box": "simulator.randomization",
}

__all__ = ["__version__", *_PUBLIC]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(import_module(f"maidenflight.{_PUBLIC[name]}"), name)
    raise AttributeError(f"module 'maidenflight' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
