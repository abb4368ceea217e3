"""A policy's memory as C: what stands in the templates where a policy remembers.

Where it does not, every piece is empty, and the files have no word of it.
"""

from string import Template

import numpy as np

from maidenflight.simulator.gru import Gru

_PIECES = {
    "memory_told": """
 * Its last MF_MEMORY numbers are what the policy remembers of its flight, zeros in the
 * first step; those of mf_network's output are what it remembers next. mf_policy_step
 * carries them over.""",
    "memory_network": ", a gated recurrent unit of $size behind the first layer",
    "memory_defines": """
#define MF_MEMORY $size /* numbers that the policy remembers */""",
    "memory_size": " + MF_MEMORY",
    "memory_less": " - MF_MEMORY",
    "memory_remembered": ", then the memory",
    "memory_function": """/* e^x to 2e-7 of itself, for |x| <= 30; a NaN stays one. Source: the
 * reduction and the polynomial of Cephes, expf. */
static float exponential(float x)
{
    if (x != x) {
        return x;
    }
    x = x < -30.0f ? -30.0f : (x > 30.0f ? 30.0f : x);
    const int32_t power = (int32_t)(x * 1.44269504f + (x < 0.0f ? -0.5f : 0.5f));
    const float rest = x - (float)power * 0.693359375f + (float)power * 2.12194440e-4f;
    float sum = 1.9875691500e-4f;
    sum = sum * rest + 1.3981999507e-3f;
    sum = sum * rest + 8.3334519073e-3f;
    sum = sum * rest + 4.1665795894e-2f;
    sum = sum * rest + 1.6666665459e-1f;
    sum = sum * rest + 5.0000001201e-1f;
    union {
        uint32_t bits;
        float number;
    } scale;
    scale.bits = (uint32_t)(power + 127) << 23;
    return (sum * rest * rest + rest + 1.0f) * scale.number;
}

static float logistic(float x)
{
    return 1.0f / (1.0f + exponential(-x));
}

/* The gated recurrent unit: what is remembered next. Source: Cho et al. 2014;
 * the reset gate acts behind the product with the memory. */
static void recur(const float *values, const float *memory, float *next)
{
    ${storage}float given[GATES];$shared
    ${storage}float known[GATES];$shared
    apply(&from_values, values, given);
    apply(&from_memory, memory, known);
    for (size_t i = 0; i < MF_MEMORY; i++) {
        const float reset = logistic(given[i] + known[i]);
        const float update = logistic(given[MF_MEMORY + i] + known[MF_MEMORY + i]);
        const float sum = given[2 * MF_MEMORY + i] + reset * known[2 * MF_MEMORY + i];
        const float candidate = 2.0f * logistic(2.0f * sum) - 1.0f; /* tanh */
        next[i] = (1.0f - update) * candidate + update * memory[i];
    }
}

""",
    "memory_first": """        if (i == 0) {
            float *const remembered = action + MF_ACTION_SIZE;
            recur(values[1], observation + MF_OBSERVATION_SIZE - MF_MEMORY, remembered);
            for (size_t j = 0; j < MF_MEMORY; j++) {
                values[1][FIRST + j] = remembered[j];
            }
        }
""",
    "memory_forgotten": """    for (size_t i = 0; i < MF_MEMORY && !state->begun; i++) {
        state->history[MF_OBSERVATION_SIZE - MF_MEMORY + i] = 0.0f;
    }
""",
    "memory_carried": """    for (size_t i = 0; i < MF_MEMORY; i++) {
        state->history[MF_OBSERVATION_SIZE - MF_MEMORY + i] = action[MF_ACTION_SIZE + i];
    }
""",
    "memory_checked": """    const layer both[2] = {from_values, from_memory};
    for (size_t i = 0; i < 2; i++) {
        sum = checksum(sum, both[i].weights, both[i].inputs * both[i].outputs);
        sum = checksum(sum, both[i].biases, both[i].outputs);
    }
""",
    "memory_constants": """
#define FIRST $first
#define GATES $gates""",
    "memory_layers": """

static const layer from_values = {recurrent_weights_1, recurrent_biases_1, $first, $gates};
static const layer from_memory = {recurrent_weights_2, recurrent_biases_2, $size, $gates};""",
}
"""Pieces of `policy.h` and `policy.c`."""


def in_policy(gru: Gru | None, storage: str, shared: str) -> dict[str, str]:
    """Returns what the templates of `policy.h` and `policy.c` take, by name.

    Args:
        gru: of the policy.
        storage: of arrays in the network, `"static "` or nothing.
        shared: comment on it.
    """
    if gru is None:
        return dict.fromkeys(_PIECES, "")
    gates, first = np.shape(gru.weights)
    numbers = {"size": gru.size, "first": first, "gates": gates + -gates % 4}
    words = {**numbers, "storage": storage, "shared": shared}
    return {name: Template(piece).substitute(words) for name, piece in _PIECES.items()}
