"""What transfer, envelope and predict have in common: they fly policies, and name the best."""

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight import names
from maidenflight.errors import InputError, first_few
from maidenflight.registry import EXPORTERS
from maidenflight.settings import choice, or_code, path, setting
from maidenflight.terminal import Table
from maidenflight.verb import Result, Verb
from maidenflight.verbs import shared

if TYPE_CHECKING:
    from polars import DataFrame

    from maidenflight.experiments.policies import Policies
    from maidenflight.policy import Policy
    from maidenflight.simulator.realities.reality import AnyReality


class FliesPolicies(Verb):
    """Fly policies."""

    policies: tuple[str, ...] = shared.policies()
    control: str | None = shared.control_of_authors()
    task: str | None = setting(
        or_code(choice(*names.TASKS)),
        None,
        "What they fly (what they were trained for by default; tracking policies the circle).",
        group=shared.FLIGHTS,
    )
    reference: Path | None = setting(
        path("a CSV file", "FILE"),
        None,
        "What they follow instead: columns t, x, y, z [s, m], or way-points x, y, z.",
        files=True,
    )

    def check_early(self) -> None:
        """Refuses a drone that is not there, and a reference that is no CSV file."""
        shared.must_exist(getattr(self, "drone", None))
        if self.reference is not None and self.reference.suffix != ".csv":
            raise InputError(f"{self.reference}: expected a file whose name ends with .csv.")

    def check(self) -> None:
        """Refuses what is no policy or no task."""
        from maidenflight.simulator.tasks.tasks import find_task

        if self.get("policies"):
            _ = self.fleet
        if self.chosen_task is not None:
            find_task(self.chosen_task)

    @property
    def chosen_task(self) -> str | None:
        """Returns the name of the task that the user chose, or the file of the reference."""
        return self.task if self.reference is None else str(self.reference)

    def longest(self, task: str, duration: float) -> float:
        """Returns how long flights of a task last at most [s]: until a reference of a file ends."""
        from maidenflight.simulator.tasks.tasks import find_task

        end = find_task(task).duration if self.reference is not None else duration
        return min(end, duration)

    @cached_property
    def fleet(self) -> "Policies":
        """Returns the policies."""
        from maidenflight.experiments.policies import read_policies

        return read_policies(self.policies, self.control)

    def describe_other_drones(self, drones: Iterable[str]) -> list[str]:
        """Returns a line on each drone that policies were not made for.

        Args:
            drones: names or files of those that fly, or virtual drones about none of them.
        """
        from maidenflight.identification import drone_file
        from maidenflight.identification.identity import (
            describe_other_counts,
            describe_other_drone,
            identity_of,
        )
        from maidenflight.simulator.realities.virtual_drone import RANGES, VARIANTS

        lines = []
        for drone in dict.fromkeys(drones):
            is_drawn = drone.partition(":")[0] in VARIANTS
            drawn = {"name": drone, "mass": sum(RANGES["mass"]) / 2.0}
            flying = None if is_drawn else drone_file.read(drone)
            other, groups = drawn if flying is None else identity_of(flying), {}
            for name, file in zip(self.fleet.own_names, self.fleet.files, strict=True):
                difference = describe_other_drone(file.identity, other)
                if flying is not None:
                    counts = file.policy.interface.full_scale_counts
                    difference = difference or describe_other_counts(counts, flying)
                groups.setdefault(difference, []).append(name)
            lines += [
                f"{first_few(group)}: {difference}. Train for the drone that flies."
                for difference, group in groups.items()
                if difference
            ]
        return lines

    def conclude(
        self,
        content: Mapping[str, Any],
        summary: Sequence[Table | str],
        flights: "DataFrame",
        output: Path,
        verdict: str = "",
        **parts: Any,
    ) -> Result:
        """Returns the result, with the best policy and the command that judges it.

        Args:
            content: of the flights, for `--json`.
            summary: likewise for people.
            flights: by which `comparison.choose_best` chooses.
            output: where the results are.
            verdict: on the best policy, the last line of the summary.
            parts: the other parts of the result.
        """
        from maidenflight.experiments import comparison

        if self.reference is not None:
            parts["notes"] = [*parts["notes"], *_describe_run_up(self.reference)]
        task = parts["record"]["settings"].get("task")
        best = self.choose_best(flights)
        rule = comparison.RULE
        best_line = [f"best: {best} ({rule})"] if best and len(self.fleet.files) > 1 else []
        return Result(
            content={
                **content,
                "best": str(best) if best else None,
                **({"task": task} if task else {}),
                "notes": parts["notes"],
                "simulated": True,
                "output": str(output),
            },
            summary=[*summary, *best_line, *([verdict] if verdict else [])],
            **parts,
        )

    def choose_best(self, flights: "DataFrame") -> Path | None:
        """Returns the file of the best policy of ours, if there is any."""
        from maidenflight.experiments import comparison

        return self.fleet.path_of(comparison.choose_best(flights, self.fleet.own_names))


def _describe_run_up(file: Path) -> list[str]:
    """Returns a sentence where `read_reference` adds a run-up to the rows of a file."""
    from maidenflight.simulator.tasks.waypoints import read_reference, read_waypoints

    end = read_waypoints(file)[-1][0]
    _, duration = read_reference(file)
    if duration == end:
        return []
    return [
        f"{file}: its rows begin or end in motion. They are flown up to from rest, and to rest "
        f"behind: {duration:.1f} s for {end:.1f} s of rows."
    ]


def export_command(path: Path, policy: "Policy") -> tuple[object, ...]:
    """Returns the words of the command that exports a policy, with what its form needs."""
    return ("export", path, *(("--to", policy.spec.form) if policy.spec.form in EXPORTERS else ()))


class InRealities(FliesPolicies):
    """Fly policies in realities."""

    reality: tuple[str, ...] = shared.realities(
        (),
        f"Where: {shared.REALITIES}, or from 5 s on as +yaw6000@5, +weak10@5, +payload15@5; may be "
        "repeated (virtual:7 by default, about --drone).",
    )
    drone: str | None = shared.drone(
        None,
        "Your drone, a TOML file or a name: policies fly virtual:7@DRONE unless --reality says.",
    )
    accept_bounds: bool = shared.accept_bounds()

    def check(self) -> None:
        """Refuses what is no drone or no reality, too."""
        from maidenflight.experiments import drones

        if self.get("drone"):
            drones.read_drone(self.drone or "", self.accept_bounds)
        if self.reality or self.get("drone"):
            _ = self.realities
        super().check()

    @cached_property
    def realities(self) -> "list[AnyReality]":
        """Returns where they fly."""
        from maidenflight.experiments import drones

        usual = f"virtual:7@{self.drone}" if self.drone else "virtual:7"
        return [drones.find_reality(name, self.accept_bounds) for name in self.reality or (usual,)]

    @property
    def flying_drones(self) -> list[str]:
        """Returns the drones that fly: names, files, and virtual drones about none of them."""
        from maidenflight.experiments.drones import drone_of
        from maidenflight.simulator.realities.reality import is_drone
        from maidenflight.simulator.realities.virtual_drone import VARIANTS

        places = map(drone_of, self.reality or (self.drone or "virtual:7",))
        return [name for name in places if is_drone(name) or name.partition(":")[0] in VARIANTS]

    def choose_next(self, best: Path) -> tuple[object, ...]:
        """Returns the words of the command that judges policies; it exports what no judge flies."""
        from maidenflight.experiments.flight_times import GUARD_RATE
        from maidenflight.simulator.realities.reality import is_drone

        policy = self.fleet.policy_of(best)
        if GUARD_RATE % policy.interface.rate:
            return export_command(best, policy)
        drone = next(filter(is_drone, self.flying_drones), "DRONE")
        foreign = set(self.fleet.foreign_files)
        files = [
            file for file in self.policies if Path(file).exists() and Path(file) not in foreign
        ]
        more = {"control": self.control, "task": self.task, "reference": self.reference}
        options = [word for name, value in more.items() if value for word in (f"--{name}", value)]
        return ("predict", *files, "--drone", drone, *options)

    def conclude(
        self,
        content: Mapping[str, Any],
        summary: Sequence[Table | str],
        flights: "DataFrame",
        output: Path,
        verdict: str = "",
        **parts: Any,
    ) -> Result:
        """Returns the result, with notes on policies of other drones and the judge as next."""
        parts["notes"] = [*parts["notes"], *self.describe_other_drones(self.flying_drones)]
        if best := self.choose_best(flights):
            parts["next"] = words = self.choose_next(best)
            if "DRONE" in words:
                parts["next_remark"] = "DRONE: a TOML file, or a name of maidenflight drone --list"
        return super().conclude(content, summary, flights, output, verdict, **parts)

    def make_flight_record(self, task: str, **more: Any) -> dict[str, Any]:
        """Returns how the flights of a task are made, for their files."""
        places = [reality.name for reality in self.realities]
        return self.make_record(
            self.fleet.inputs, task=task, reality=places, **more, **self.fleet.record
        )
