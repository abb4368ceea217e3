"""A policy's spec says all that follows from it, and refuses what makes no sense."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from maidenflight.errors import InputError
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.tasks.look_ahead import LookAhead

FULL = PolicySpec(history=3, look_ahead=LookAhead(2, 0.25), memory=5, hidden=(8, 6))


@pytest.mark.parametrize(
    "wrong",
    [
        *({"history": value} for value in (0, -1, 1001, 2.0, True, None, "2")),
        *({"memory": value} for value in (-1, 257, 1.0, True)),
        *({"hidden": value} for value in ((0,), (8.0,), [8], 8, (True,))),
        *({"form": value} for value in ("foundation", "", None)),
        {"look_ahead": 5},
        {"memory": 5, "hidden": ()},
    ],
    ids=str,
)
def test_a_field_out_of_range_is_refused_by_its_name(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        PolicySpec(**wrong)


def test_what_the_papers_policies_do_not_have_is_told_and_nothing_else() -> None:
    assert PolicySpec().to_dict() == {"history": 2, "hidden": [50, 50]}
    assert PolicySpec().beyond() == ""
    assert FULL.beyond("history", "hidden", "memory") == (
        "look_ahead = {'points': 2, 'spacing': 0.25}"
    )
    assert FULL.beyond("look_ahead") == "history = 3, memory = 5, hidden = [8, 6]"
    for spec in (PolicySpec(), FULL, PolicySpec(form="raptor")):
        assert PolicySpec.from_dict(spec.to_dict()) == spec
        assert hash(PolicySpec.from_dict(spec.to_dict())) == hash(spec)
    # A look-ahead of no points is none, whatever its spacing.
    assert PolicySpec(look_ahead=LookAhead(0, 0.3)) == PolicySpec()


def test_an_observation_has_the_size_of_the_spec_and_its_parts_in_order() -> None:
    history, points = jnp.arange(60.0).reshape(3, 20), jnp.ones((2, 3))
    seen = FULL.observation(history, points, jnp.full(3, 0.25), jnp.full(5, 7.0))
    assert (seen.size, FULL.observed_size, FULL.layer_sizes) == (FULL.size, 66, (66, 8, 6, 4))
    np.testing.assert_array_equal(seen, [*range(60), *[0.75] * 6, *[7.0] * 5])
    assert [len(part) for part in FULL.scaling] == [66, 66]
    assert PolicySpec().points(lambda _: jnp.ones(3), jnp.zeros(())).shape == (0, 3)
