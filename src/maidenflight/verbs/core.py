"""What verbs take from the rest of the package, each imported when it is first used.

`--help` thus imports neither JAX nor polars.
"""

import ast
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jax.random import split as split_key
    from numpy import float32
    from polars import DataFrame

    from maidenflight import parameters, policy_file
    from maidenflight.deployment.c import digest
    from maidenflight.deployment.check import check_export, check_frame
    from maidenflight.experiments import comparison, drones, envelope, flight_times
    from maidenflight.experiments.policies import Policies, read_policies
    from maidenflight.experiments.real_controller import FIRMWARE as REAL_FIRMWARE
    from maidenflight.experiments.real_controller import real_controller
    from maidenflight.experiments.transfer import fly_firmware, transfer
    from maidenflight.experiments.verdict import verdicts
    from maidenflight.flights import flight_plan
    from maidenflight.flights.flight_plan import FlightPlan
    from maidenflight.flights.log import Flight
    from maidenflight.flights.reading import COMMANDS, Flights, read_flights
    from maidenflight.flights.summary import Summary, choose_most_telling, summaries
    from maidenflight.flights.summary import rank as rank_logs
    from maidenflight.flying import recording
    from maidenflight.identification import drone_file, identity
    from maidenflight.identification.behaviour import BEHAVIOUR, flights_of_policies
    from maidenflight.identification.calibration import draw_calibrations, uniform_band
    from maidenflight.identification.calibration import summarize as summarize_calibration
    from maidenflight.identification.closed_loop import ClosedLoop, Match, match
    from maidenflight.identification.design import planning
    from maidenflight.identification.drone_file import CLOSED_LOOP, DroneFile
    from maidenflight.identification.held_out import note_not_held_out, note_other_law
    from maidenflight.identification.identify import identify
    from maidenflight.identification.likelihood.compiling import start_compiling
    from maidenflight.identification.likelihood.one_step import log_likelihood
    from maidenflight.identification.methods import Likelihood, Replay
    from maidenflight.identification.outcome.bounds import at_bounds
    from maidenflight.identification.outcome.ensembles import posterior_ensemble
    from maidenflight.identification.outcome.estimates import SURE_NATS, Identification, source_of
    from maidenflight.identification.outcome.progress import Overall
    from maidenflight.identification.outcome.progress import Progress as Stage
    from maidenflight.identification.replay.prediction import (
        PERSISTENCE,
        predicted_windows,
        prediction_error,
        with_own_trim,
        without_torque,
    )
    from maidenflight.identification.start import note_mass, note_start_at_bounds, read_start
    from maidenflight.identification.truth import read_truth
    from maidenflight.parameters import COMPONENTS, QUANTITIES, Parameters, crazyflie
    from maidenflight.policy import Policy
    from maidenflight.policy_file import PolicyFile
    from maidenflight.reporting.figures.envelope import envelope as envelope_figure
    from maidenflight.reporting.figures.identification import (
        identification as identification_figure,
    )
    from maidenflight.reporting.figures.picture import svg
    from maidenflight.reporting.page import report, report_comparison
    from maidenflight.reporting.text import ERRORS
    from maidenflight.simulator.controllers import control
    from maidenflight.simulator.policy_spec import PolicySpec
    from maidenflight.simulator.realities.reality import AnyReality
    from maidenflight.simulator.realities.virtual_drone import VirtualDrone, must_be_virtual
    from maidenflight.simulator.tasks.look_ahead import LookAhead
    from maidenflight.simulator.tasks.tasks import find_task, with_yaw_penalty
    from maidenflight.studies import sweeping
    from maidenflight.studies.engine import Resources
    from maidenflight.studies.status import Progress as Status
    from maidenflight.studies.status import clock
    from maidenflight.studies.status import read_status as read_status
    from maidenflight.studies.store import opened as open_store
    from maidenflight.studies.study import Study
    from maidenflight.studies.study import read_study as read_study
    from maidenflight.training import checkpoint, defaults, folder, loggers
    from maidenflight.training.checkpoint import Checkpoint
    from maidenflight.training.scores import Scores, describe_spread
    from maidenflight.training.settings import Settings, override, recorded
    from maidenflight.training.train import Progress as Training
    from maidenflight.training.train import train
    from maidenflight.verbs import estimates_output, logs
else:

    def __getattr__(name: str) -> Any:
        """Imports a name as the lines above say."""
        if name not in _sources():
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        module, original = _sources()[name]
        return getattr(__import__(module, fromlist=[original]), original)


@cache
def _sources() -> dict[str, tuple[str, str]]:
    """Returns the module of each name, and what it is called there."""
    (block,) = (
        statement
        for statement in ast.parse(Path(__file__).read_text()).body
        if isinstance(statement, ast.If)
    )
    return {
        alias.asname or alias.name: (str(line.module), alias.name)
        for line in block.body
        if isinstance(line, ast.ImportFrom)
        for alias in line.names
    }
