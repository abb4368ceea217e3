"""The verbs with files at both ends, as the command line and the demo run them.

Each function reads what it is given, does one stage, writes its results with a record of their
making, and returns them.
"""

from maidenflight.workflow.closed_loop import match_loops
from maidenflight.workflow.conversion import convert
from maidenflight.workflow.deployment import export, export_options
from maidenflight.workflow.drones import (
    ANY,
    ANY_DAY,
    POSSIBLE,
    POSTERIOR,
    TRIMS,
    WIDE,
    drone_to_fly,
    plant,
    possible_drones,
    randomized,
    reality,
    usual_randomization,
)
from maidenflight.workflow.envelope import best_by_envelope, envelope_of
from maidenflight.workflow.flying import (
    best_policy,
    flights_to_view,
    limit_cycles,
    matrix_row,
    predict_with,
    transfer_matrix,
    transfer_summary,
    transfer_to,
)
from maidenflight.workflow.logs import Reading, Start, identify_from, record, validate_with
from maidenflight.workflow.planning import plan_for, record_planned
from maidenflight.workflow.policies import own_and_foreign, policy_files, task_to_fly
from maidenflight.workflow.training import (
    WATCHED_DURATION_S,
    best_scores,
    controller_to_train,
    train_for,
    updates_so_far,
    watched_flight,
)
from maidenflight.workflow.training_settings import SETTINGS, settings_for, usual_training_box

__all__ = [
    "ANY",
    "ANY_DAY",
    "POSSIBLE",
    "POSTERIOR",
    "SETTINGS",
    "TRIMS",
    "WATCHED_DURATION_S",
    "WIDE",
    "Reading",
    "Start",
    "best_by_envelope",
    "best_policy",
    "best_scores",
    "controller_to_train",
    "convert",
    "drone_to_fly",
    "envelope_of",
    "export",
    "export_options",
    "flights_to_view",
    "identify_from",
    "limit_cycles",
    "match_loops",
    "matrix_row",
    "own_and_foreign",
    "plan_for",
    "plant",
    "policy_files",
    "possible_drones",
    "predict_with",
    "randomized",
    "reality",
    "record",
    "record_planned",
    "settings_for",
    "task_to_fly",
    "train_for",
    "transfer_matrix",
    "transfer_summary",
    "transfer_to",
    "updates_so_far",
    "usual_randomization",
    "usual_training_box",
    "validate_with",
    "watched_flight",
]
