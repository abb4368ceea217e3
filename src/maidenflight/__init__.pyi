__version__: str
__all__: list[str]

from .deployment.c import export_c as export_c
from .experiments.flight_times import predict_flight_times as predict_flight_times
from .experiments.transfer import transfer as transfer
from .flights.log import Flight as Flight
from .flights.reading import read_flights as read_flights
from .flights.recording import record as record
from .identification.identify import identify as identify
from .identification.likelihood import Likelihood as Likelihood
from .identification.prediction import prediction_error as prediction_error
from .identification.replay import Replay as Replay
from .parameters import Parameters as Parameters
from .parameters import crazyflie as crazyflie
from .policy import Policy as Policy
from .reporting.page import report as report
from .simulator.control import attitude as attitude
from .simulator.control import attitude_rate as attitude_rate
from .simulator.control import pwm as pwm
from .simulator.environment import Environment as Environment
from .simulator.environment import reset as reset
from .simulator.environment import step as step
from .simulator.randomization import randomize as randomize
from .simulator.randomization import relative_box as relative_box
from .simulator.randomization import wide_box as wide_box
from .simulator.rollout import rollout as rollout
from .simulator.tasks import circle as circle
from .simulator.tasks import figure_eight as figure_eight
from .simulator.tasks import hover as hover
from .simulator.tasks import take_off as take_off
from .simulator.tasks import tracking as tracking
from .simulator.virtual_drone import VirtualDrone as VirtualDrone
from .simulator.virtual_drone import virtual_drone as virtual_drone
from .training.analytic_gradient import AnalyticGradient as AnalyticGradient
from .training.evaluation import evaluate as evaluate
from .training.ppo import PPO as PPO
from .training.train import train as train
