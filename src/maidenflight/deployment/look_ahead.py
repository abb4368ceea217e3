"""A policy's look-ahead as C: what stands in the templates where a policy looks ahead.

Where it does not, every piece is empty, and the files have no word of it.
"""

from string import Template

import numpy as np

from maidenflight.simulator.policy_spec import PolicySpec

_TIMES = "MF_AHEAD_SPACING, 2 MF_AHEAD_SPACING, ... later"
_IN_POLICY = {
    "ahead_told": f"""
 * Behind them stand MF_AHEAD points of the reference, 3 numbers each: where the drone shall be
 * {_TIMES} - position. The caller gives them in
 * each step; where a trajectory ends, its last point again.""",
    "ahead_example": ", {{later_x, later_y, later_z}, ...}",
    "ahead_defines": """
#define MF_AHEAD $points /* points of the reference ahead of time */
#define MF_AHEAD_SPACING $spacing /* time between two of them [s] */""",
    "ahead_size": " + 3 * MF_AHEAD",
    "ahead_less": " - 3 * MF_AHEAD",
    "ahead_field": f"""
    float ahead[MF_AHEAD][3]; /* [m], world: the setpoint {_TIMES} */""",
    "ahead_remembered": ", then the points ahead",
    "ahead_function": """/* Puts the points ahead, relative to the drone, behind the newest
 * instant; whether all are finite. */
static bool look_ahead(mf_policy_state *state, const mf_observation *now)
{
    float *points = state->history + MF_HISTORY * MF_INSTANT_SIZE;
    for (size_t i = 0; i < MF_AHEAD; i++) {
        for (size_t j = 0; j < 3; j++) {
            points[3 * i + j] = now->ahead[i][j] - now->position[j];
        }
    }
    return all_finite(points, 3 * MF_AHEAD);
}

""",
    "ahead_call": " || !look_ahead(state, now)",
}
"""Pieces of `policy.h` and `policy.c`."""
_IN_APP = {
    "ahead_readme": " This policy looks ahead. With `mf.task` 2 it takes position, velocity and "
    "acceleration of the\nset-point as what comes: send full states, or trajectories of the "
    "high-level commander.",
    "ahead_here": "    foresee(setpoint, step);\n",
    "ahead_step": "const setpoint_t *setpoint, stabilizerStep_t step",
    "ahead_given": "setpoint, stabilizerStep",
    "ahead_foreseen": """/* Where the drone shall be when the policy looks ahead; of the
 * commander's set-points by their velocity and acceleration. */
static void foresee(const setpoint_t *setpoint, stabilizerStep_t step)
{
    const float now = (float)(step - begun) / RATE_MAIN_LOOP;
    const float slope[3] = {setpoint->velocity.x, setpoint->velocity.y, setpoint->velocity.z};
    const float bend[3] = {setpoint->acceleration.x, setpoint->acceleration.y,
                           setpoint->acceleration.z};
    for (int i = 0; i < MF_AHEAD; i++) {
        const float later = (float)(i + 1) * MF_AHEAD_SPACING;
        const float angle = circle_angle(now + later);
        const bool circles = plan.task == MF_TASK_CIRCLE;
        seen.ahead[i][0] = circles ? plan.radius * (1.0f - cosf(angle)) : 0.0f;
        seen.ahead[i][1] = circles ? plan.radius * sinf(angle) : 0.0f;
        seen.ahead[i][2] = plan.height;
        for (int j = 0; plan.task == MF_TASK_COMMANDER && j < 3; j++) {
            seen.ahead[i][j] = seen.setpoint[j] + later * (slope[j] + 0.5f * later * bend[j]);
        }
    }
}

""",
    "ahead_parameter": "PARAM_ADD(PARAM_UINT8 | PARAM_RONLY, ahead, &ahead)\n",
    "ahead_variable": "static uint8_t ahead = MF_AHEAD; /* read only: points ahead that the "
    "policy sees */\n",
}
"""Pieces of the Crazyflie app."""
_WITHOUT = {"ahead_step": "void"}


def in_policy(spec: PolicySpec) -> dict[str, str]:
    """Returns what the templates of `policy.h` and `policy.c` take, by name."""
    look_ahead = spec.look_ahead
    if not look_ahead.points:
        return dict.fromkeys(_IN_POLICY, "")
    spacing = f"{np.float32(look_ahead.spacing)!s}f"
    defines = Template(_IN_POLICY["ahead_defines"])
    filled = defines.substitute(points=look_ahead.points, spacing=spacing)
    return {**_IN_POLICY, "ahead_defines": filled}


def in_app(spec: PolicySpec) -> dict[str, str]:
    """Returns what the templates of the Crazyflie app take, by name."""
    if not spec.look_ahead.points:
        return {**dict.fromkeys(_IN_APP, ""), **_WITHOUT}
    return dict(_IN_APP)
