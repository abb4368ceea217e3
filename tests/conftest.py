"""Strict JAX, so that no shape or dtype is guessed, and the same examples from hypothesis on every run."""

import jax
from hypothesis import settings

jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

settings.register_profile("reproducible", derandomize=True, deadline=None, max_examples=25, database=None)
settings.load_profile("reproducible")
