__version__: str
__all__: list[str]

from . import simulator as simulator
from .compiler import prepare_jax as prepare_jax
from .deployment import export as export
from .deployment.drone_format import export_drone as export_drone
from .errors import InputError as InputError
from .experiments.envelope import envelope as envelope
from .experiments.flight_times import predict_flight_times as predict_flight_times
from .experiments.transfer import transfer as transfer
from .flights.log import Flight as Flight
from .flights.reading import read_flights as read_flights
from .flying.recording import record as record
from .identification.drone_file import DroneFile as DroneFile
from .identification.identify import expected_intervals as expected_intervals
from .identification.identify import identify as identify
from .identification.likelihood.one_step import log_likelihood as log_likelihood
from .identification.methods import Likelihood as Likelihood
from .identification.methods import Replay as Replay
from .identification.replay.prediction import prediction_error as prediction_error
from .parameters import Parameters as Parameters
from .parameters import crazyflie as crazyflie
from .parameters import drone as drone
from .policy import Actor as Actor
from .policy import Policy as Policy
from .policy import untrained_policy as untrained_policy
from .policy_file import PolicyFile as PolicyFile
from .reporting.page import report as report
from .simulator.policy_spec import PolicySpec as PolicySpec
from .simulator.realities.reality import reality as reality
from .simulator.realities.virtual_drone import virtual_drone as virtual_drone
from .studies.sweeping import sweep as sweep
from .training.analytic_gradient import AnalyticGradient as AnalyticGradient
from .training.distillation import Distillation as Distillation
from .training.evaluation import evaluate as evaluate
from .training.settings import PPO as PPO
from .training.train import train as train
