"""What transfer and envelope have in common: policies that fly in realities."""

from typing import TYPE_CHECKING

from maidenflight import names
from maidenflight.settings import choice, setting
from maidenflight.verb import Verb
from maidenflight.verbs import shared

if TYPE_CHECKING:
    from maidenflight.simulator.reality import AnyReality
    from maidenflight.verbs.policies import Policies


class InRealities(Verb):
    """Fly policies in realities."""

    policies: tuple[str, ...] = shared.policies()
    reality: tuple[str, ...] = shared.realities(
        (),
        f"Where: {shared.REALITIES}, or from 5 s on as +yaw6000@5, +weak10@5, +payload15@5; may be "
        "repeated (virtual:7 unless given, about --drone).",
    )
    drone: str | None = shared.drone(
        None,
        "Your drone, a TOML file or a name: policies fly virtual:7@DRONE unless --reality says.",
    )
    accept_bounds: bool = shared.accept_bounds()
    task: str | None = setting(
        choice(*names.TASKS),
        None,
        "What they fly (what they were trained for unless given).",
        group=shared.FLIGHTS,
    )

    def check_early(self) -> None:
        """Refuses a drone that is not there."""
        shared.must_exist(self.drone)

    def check(self) -> None:
        """Refuses what is no drone, no reality or no policy."""
        from maidenflight.experiments.drones import read_drone

        if self.get("drone"):
            read_drone(self.drone or "", self.accept_bounds)
        if self.reality or self.get("drone"):
            self.find_realities()
        if self.get("policies"):
            self.load()

    def load(self) -> "Policies":
        """Reads the policies."""
        from maidenflight.verbs.policies import read_policies

        return read_policies(self.policies)

    def find_realities(self) -> "list[AnyReality]":
        """Returns where they fly."""
        from maidenflight.experiments.drones import find_reality

        usual = f"virtual:7@{self.drone}" if self.drone else "virtual:7"
        return [find_reality(name, self.accept_bounds) for name in self.reality or (usual,)]
