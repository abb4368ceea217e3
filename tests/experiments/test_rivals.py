"""What the judge flies beside: changed drones, and what a verdict says of them."""

import polars

from maidenflight.experiments.rivals import changed_drones, describe_changes, summarize
from maidenflight.names import CHANGES
from maidenflight.parameters import component, crazyflie, replace
from maidenflight.simulator.realities.virtual_drone import VirtualDrone

NAMED = {"mine+10ms": "10 ms more latency", "mine+weak10": "a motor 10 % weaker"}


def test_each_change_is_flown_alone_and_what_the_drone_cannot_lift_is_said():
    drone = crazyflie()
    changed, notes = changed_drones(VirtualDrone("mine", drone))
    assert [one.name for one in changed] == [f"mine+{one}" for one in CHANGES]
    differing = {
        one.name: {
            name
            for name in ("latency", "mass", "rotor_thrust_1")
            if component(one.parameters, name) != component(drone, name)
        }
        for one in changed
    }
    assert [*differing.values()] == [{"latency"}, {"mass"}, {"rotor_thrust_1"}]
    assert notes == []
    weak = VirtualDrone("mine", replace(drone, thrust_to_weight=1.1))
    changed, (note,) = changed_drones(weak)
    assert len(changed) == len(CHANGES) - 1
    assert "payload" in note


def test_a_verdict_says_with_which_changes_a_policy_lasts():
    def flights(lasting: int) -> polars.DataFrame:
        ends = ["time limit"] * lasting + ["tilt"] * (4 - lasting)
        return polars.DataFrame(
            {
                "policy": ["policy_1"] * 4,
                "duration": [20.0] * lasting + [8.0] * (4 - lasting),
                "position_error": [0.12] * 4,
                "estimated_error": [0.01] * 4,
                "end_reason": ends,
            }
        )

    rows = polars.concat(
        [
            summarize(flights(4), "mine"),
            summarize(flights(1), "mine+10ms"),
            summarize(flights(4), "mine+weak10"),
        ]
    )
    assert rows["time_limit"].to_list() == [4, 1, 4]
    sentence = describe_changes(rows, "policy_1", NAMED)
    assert "a motor 10 % weaker" in sentence
    assert "with 10 ms more latency 3 of 4 end by tilt (11.0 s in the mean)" in sentence
    assert describe_changes(rows, "policy_2", NAMED) == ""
