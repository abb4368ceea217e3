"""`Match`: the drone with which policies behave in simulation as they did in logs."""

import dataclasses
import math
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from maidenflight import run_folder
from maidenflight.errors import InputError
from maidenflight.terminal import Table
from maidenflight.verb import Output, Progress, Result, Verb
from maidenflight.verbs import shared

if TYPE_CHECKING:
    from maidenflight.identification import closed_loop
    from maidenflight.identification.drone_file import DroneFile


class Match(Verb):
    """Match a drone to LOGS that POLICIES flew.

    Parameters are changed until the policies behave in simulation as they did in the logs. LOGS is
    a flight log or a folder of them, POLICIES files or folders of the policies that flew them,
    among others. Begin with a drone that identify estimated.
    """

    output = Output(run_folder.DRONE, "TOML file for the drone.")
    parallel = True

    logs: Path = shared.logs()
    policies: tuple[str, ...] = shared.policies()
    start: str = shared.drone("crazyflie", "Drone to begin with: a TOML file of identify.")
    mass: float | None = shared.mass()
    most_seconds: float = shared.most_seconds()
    ignore: tuple[str, ...] = shared.ignore()
    commands: str | None = shared.commands()
    battery_law: str | None = shared.battery_law()
    conditions: Path | None = shared.conditions()
    seed: int = shared.seed()

    def check(self) -> None:
        """Refuses a start that is no drone, and conditions that are none."""
        from maidenflight.experiments.conditions import read_conditions

        read_conditions(self.conditions)
        if self.get("start"):
            _ = self.first

    @cached_property
    def first(self) -> "DroneFile":
        """Returns the drone to begin with."""
        from maidenflight.identification.start import read_start

        return read_start(self.start, self.mass)

    def compute(self, output: Path, progress: Progress) -> Result:
        """Matches; writes the start with the estimates in place."""
        from maidenflight.experiments import drones
        from maidenflight.experiments.conditions import read_conditions
        from maidenflight.experiments.policies import read_policies
        from maidenflight.flights.reading import read_flights
        from maidenflight.identification import closed_loop
        from maidenflight.identification.behaviour import BEHAVIOUR, flights_of_policies
        from maidenflight.identification.drone_file import CLOSED_LOOP
        from maidenflight.identification.outcome.estimates import source_of
        from maidenflight.verbs.parts import logs_output

        progress.move(0, None, "compiling")
        loaded, loop = read_policies(self.policies), closed_loop.ClosedLoop()
        policies = dict(zip(loaded.own_names, loaded.own, strict=True))
        flights = read_flights(
            *(self.logs, None, self.most_seconds, 0),
            commands=self.commands,
            battery_law=self.battery_law,
            ignore=self.ignore,
        )
        matched_flights = flights_of_policies(flights.flights, policies)
        if not matched_flights:
            raise InputError(
                f"{self.logs}: none of {len(policies)} policies gives the commands of any of "
                f"{len(flights)} flights. Give the policies that flew, and logs at their rate that "
                "hold the estimates which the policies saw."
            )
        usual = drones.choose_prediction(self.first)
        match = closed_loop.match(
            matched_flights,
            policies,
            drones.possible_drones(self.first, usual, self.seed),
            self.key,
            loop,
            read_conditions(self.conditions).controller_for,
            lambda done, of, cost: progress.move(done, of, f"difference {cost:.3g}"),
            flights.flights,
        )
        start = shared.own_files(self.start)
        record = self.make_record(
            [*flights.paths, *loaded.paths, *start, *shared.own_files(self.conditions)],
            policies=None,
            objective=CLOSED_LOOP,
            **dataclasses.asdict(loop),
        )
        source = source_of([flight for own in matched_flights.values() for flight in own])
        match.put_into(self.first, source, record).write(output)
        values = {
            name: {"value": value, "standard_error": error}
            for name, (value, error) in match.estimates.items()
        }
        behaviour = {
            name: {"before": round(float(before), 4), "after": round(float(after), 4)}
            for name, before, after in zip(BEHAVIOUR, match.before, match.after, strict=True)
        }
        return Result(
            content={
                "parameters": values,
                "behaviour": behaviour,
                "policies": match.policies,
                "compared": match.flights,
                "evaluations": match.evaluations,
                "flights": logs_output.to_content(flights),
                "output": str(output),
            },
            summary=[
                *_tabulate(match),
                f"{match.flights} of {len(flights)} flights, of {match.policies} policies, were "
                "compared",
            ],
            written={"drone": [output]},
            read={"logs": flights.paths, "policies": loaded.paths, "drone": start},
            record=record,
            rows=[{"parameter": name, **row} for name, row in values.items()],
            next=("predict", "POLICIES", "--drone", output),
            value=match,
        )


def _tabulate(match: "closed_loop.Match") -> list[Table]:
    from maidenflight.identification.behaviour import BEHAVIOUR
    from maidenflight.verbs.parts import logs_output

    rows = []
    for name, (value, error) in match.estimates.items():
        scale, unit = logs_output.scale_of(name, value)
        low, high = max(value - 1.96 * error, 0.0) * scale, (value + 1.96 * error) * scale
        rows.append({"name": name, "value": value * scale, "low": low, "high": high, "unit": unit})
    columns = {"parameter": "{name}", "value": "{value:.4g}"}
    columns |= {"95 % interval": "{low:.4g} .. {high:.4g}", "unit": "{unit}"}
    shares = [
        {"of": name, "before": math.exp(before), "after": math.exp(after)}
        for name, before, after in zip(BEHAVIOUR, match.before, match.after, strict=True)
    ]
    return [
        Table("Parameters of the closed loop", columns, rows),
        Table(
            "Standard deviations, simulated over logged, median of the policies",
            {"of": "{of}", "before": "{before:.2f}", "after": "{after:.2f}"},
            shares,
        ),
    ]
