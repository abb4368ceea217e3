"""The drones that may be the physics of a firmware elsewhere."""

import pytest

from maidenflight.errors import InputError
from maidenflight.integrations.plant.running_plant import find_plant


def test_a_plant_is_refused_at_once_where_the_drone_changes_in_flight() -> None:
    assert callable(find_plant("virtual:1+yaw600", 0))
    with pytest.raises(InputError, match="virtual-1"):
        find_plant("virtual:1+yaw600@1", 0)
