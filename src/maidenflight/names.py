"""Names by which users choose what the package offers; importing them imports nothing else."""

from typing import Literal, get_args

CONTROLS = ("pwm", "attitude_rate", "attitude")
"""The paper's control structures (Gronauer et al. 2022, sec. Control Structures)."""
POSITION_PID = "position_pid"
"""The firmware's own cascade as a control structure, which flies without a policy."""
PAPER_TASK = "paper_circle"
"""The circle at full speed from the first instant on, which the paper's policies fly."""
TRACKING = "tracking"
"""The task of policies that follow any reference."""
TASKS = (
    *("circle", "figure_eight", "fast_circle", "fast_figure_eight", "hover", "take_off"),
    *(TRACKING, PAPER_TASK),
)
"""What policies are trained to fly."""
REAL_TASKS = ("circle", "figure_eight", "hover")
"""What a real drone flies."""
AXES = ("speed", "circle", "figure_eight", "gusts", "payload", "battery", "propeller", "latency")
"""Along which an envelope grows harder."""
Firmware = Literal["2021.10", "2026.08"]
FIRMWARES: tuple[Firmware, ...] = get_args(Firmware)
"""Generations of the Crazyflie's firmware: of the paper's flights, and today's."""
CONTROLLERS = ("pid", "mellinger")
"""Controllers of the firmware that fly recordings."""
CHANGES = ("10ms", "payload15", "weak10")
"""Of a drone, as additions to a reality's name, with which the judge flies; ours."""
PROPELLERS = ("2.1+", "legacy", "thrust-upgrade")
"""By which the Crazyflie's firmware compensates for the battery."""
METHODS = ("gradient", "gradient-paper", "distillation", "ppo", "ppo-paper")
"""Of training; the last with the paper's settings."""
FORMS = ("instants", "raptor", "px4")
"""Of policies: what their network sees and gives."""
COMMANDS = ("zero-order-hold", "subsampled")
"""What logged commands stand for: each acts until the next row, or one in some is logged."""
OPTIONAL_SIGNALS = ("accelerometer", "rotor_speed")
"""Of a flight log."""

FAULTY_LOGS = ("refuse", "skip", "use")
"""What is done with logs whose conventions contradict physics: all logs of the folder are refused,
the others are used, or they are used all the same."""

PLUS_PROPELLERS = "2.1+ propellers"
LEGACY_PROPELLERS = "legacy propellers"
THRUST_UPGRADE = "thrust upgrade"
FIRMWARE_2021 = "firmware of 2021"
UNCOMPENSATED_2021 = "firmware of 2021, before it compensates"
BRUSHLESS = "2.1 Brushless"
UNKNOWN_LAW = "unknown, PWM squared"
BATTERY_LAWS = (
    *(PLUS_PROPELLERS, LEGACY_PROPELLERS, THRUST_UPGRADE, FIRMWARE_2021),
    *(UNCOMPENSATED_2021, BRUSHLESS, UNKNOWN_LAW),
)
"""By which logged PWM is read as thrust."""

POSTERIOR = "posterior"
"""Train over or predict for the posterior samples of an identified drone."""
TRIMS = "trim"
"""Predict for drones whose constant torques differ as between the identified flights."""
WIDE = "wide"
"""Train over drones unlike the identified one too, with all the trims that its flights had."""
ANY = "any"
"""Train over small quadrotors of any make, for policies that find out in flight what they fly."""
ANY_DAY = "any-day"
"""Train over the drone as it may be on any day: `WIDE`, with trims and more."""
PERSISTENCE = "persistence"
"""Name of the prediction that position, velocity, attitude and body rates all stay as they are."""
