"""`Match`: the drone with which policies behave in simulation as they did in logs."""

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight import names, run_folder, terminal
from maidenflight.errors import InputError
from maidenflight.settings import choice, setting, several
from maidenflight.verb import Output, Progress, Result, Verb
from maidenflight.verbs import logs as read
from maidenflight.verbs import shared

if TYPE_CHECKING:
    from maidenflight.flights.reading import Flights
    from maidenflight.identification.closed_loop import Match as Matched
    from maidenflight.identification.drone_file import DroneFile, Source


class Match(Verb):
    """Match a drone to LOGS that POLICIES flew.

    Parameters are changed until the policies behave in simulation as they did in the logs. LOGS is
    a flight log or a folder of them, POLICIES files or folders of the policies that flew them,
    among others. Begin with a drone that identify found.
    """

    output = Output(run_folder.DRONE, "TOML file for the drone.")
    parallel = True

    logs: Path = shared.logs()
    policies: tuple[str, ...] = shared.policies()
    start: str = shared.drone("crazyflie", "Drone to begin with: a TOML file of identify.")
    mass: float | None = shared.mass()
    most_seconds: float = shared.most_seconds()
    ignore: tuple[str, ...] = setting(
        several(choice(*names.OPTIONAL_SIGNALS), empty=True),
        (),
        "Signal to pass over as if it had not been logged; may be repeated.",
    )
    commands: str | None = shared.commands()
    battery_law: str | None = shared.battery_law()
    seed: int = shared.seed()

    def check(self) -> None:
        """Refuses a start that is no drone."""
        if self.get("start"):
            read.read_start(self.start, self.mass)

    def compute(self, output: Path, progress: Progress) -> Result:
        """Matches; writes the start with what was found in place."""
        import jax

        from maidenflight.experiments.as_flown import controller_as_flown
        from maidenflight.experiments.drones import choose_prediction, possible_drones
        from maidenflight.flights.reading import read_flights
        from maidenflight.identification.behaviour import flown_by
        from maidenflight.identification.closed_loop import ClosedLoop, match
        from maidenflight.identification.drone_file import CLOSED_LOOP
        from maidenflight.identification.outcome.estimates import source_of
        from maidenflight.verbs.policies import read_policies

        progress.move(0, None, "compiling")
        start, loaded = read.read_start(self.start, self.mass), read_policies(self.policies)
        policies = dict(zip(loaded.own_names, loaded.own, strict=True))
        flights = read_flights(
            *(self.logs, None, self.most_seconds, 0, self.commands, self.battery_law, self.ignore)
        )
        flown = flown_by(flights.flights, policies)
        if not flown:
            raise InputError(
                f"{self.logs}: none of {len(policies)} policies gives the commands of any of "
                f"{len(flights)} flights. Give the policies that flew, and logs at their rate that "
                "hold the estimates which the policies saw."
            )
        loop = ClosedLoop()
        found = match(
            flown,
            policies,
            possible_drones(start, choose_prediction(start), self.seed),
            jax.random.key(self.seed),
            loop,
            controller_as_flown,
            lambda done, of, cost: progress.move(done, of, f"difference {cost:.3g}"),
        )
        record = self.make_record(
            [*flights.paths, *loaded.paths, *read.own_files(self.start)],
            policies=None,
            objective=CLOSED_LOOP,
            **dataclasses.asdict(loop),
        )
        source = source_of([flight for own in flown.values() for flight in own])
        _merge(start, found, source, record).write(output)
        return Result(
            content=_to_content(flights, found) | {"output": str(output)},
            show=lambda: _show(found, len(flights), output),
            written={"drone": [output]},
            read={
                "logs": flights.paths,
                "policies": loaded.paths,
                "drone": read.own_files(self.start),
            },
            record=record,
            rows=[
                {"parameter": name, "value": value, "standard_error": error}
                for name, (value, error) in found.found.items()
            ],
            next=("predict", "POLICIES", "--drone", output),
            value=found,
        )


def _merge(
    start: "DroneFile", found: "Matched", source: "Source", record: Mapping[str, Any]
) -> "DroneFile":
    """Puts what was found in place of what the search began with."""
    import numpy as np

    from maidenflight import parameters
    from maidenflight.identification.drone_file import CLOSED_LOOP, Estimate, Search

    estimates, posterior = dict(start.estimates), dict(start.posterior)
    for name, (value, error) in found.found.items():
        old = estimates.get(name)
        ends = max(value - 1.96 * error, 0.0), value + 1.96 * error
        between = 0.0 if old is None else old.between_sd
        estimates[name] = Estimate(value, ends, (value,), between)
        if name in posterior:
            drawn = posterior[name]
            unit = (drawn - drawn.mean()) / (drawn.std() or 1.0)
            posterior[name] = np.maximum(value + error * unit, 0.0)
    changes = {name: np.float32(value) for name, (value, _) in found.found.items()}
    return dataclasses.replace(
        start,
        parameters=parameters.replace(start.parameters, **changes),
        estimates=estimates,
        posterior=posterior,
        source=start.source or source,
        search=Search(CLOSED_LOOP, found.cost[1], found.flights, found.evaluations),
        record=record,
    )


def _to_content(flights: "Flights", found: "Matched") -> dict[str, Any]:
    from maidenflight.identification.behaviour import BEHAVIOUR

    return {
        "parameters": {
            name: {"value": value, "standard_error": error}
            for name, (value, error) in found.found.items()
        },
        "behaviour": {
            name: {"before": round(float(before), 4), "after": round(float(after), 4)}
            for name, before, after in zip(BEHAVIOUR, found.before, found.after, strict=True)
        },
        "policies": found.policies,
        "compared": found.flights,
        "evaluations": found.evaluations,
        "flights": read.to_content(flights),
    }


def _show(found: "Matched", flights: int, output: Path) -> None:
    """Prints what a comparison of closed loops found, of so many flights."""
    from maidenflight.identification.behaviour import BEHAVIOUR

    rows = []
    for name, (value, error) in found.found.items():
        scale, unit = read.scale_of(name, value)
        low, high = max(value - 1.96 * error, 0.0), value + 1.96 * error
        interval = f"{low * scale:.4g} .. {high * scale:.4g}"
        rows.append([name, f"{value * scale:.4g}", interval, unit])
    columns = ["parameter", "value", "95 % interval", "unit"]
    terminal.print_table("Parameters of the closed loop", columns, rows)
    terminal.print_table(
        "Standard deviations, simulated over logged, median of the policies",
        ["of", "before", "after"],
        [
            [name, f"{math.exp(before):.2f}", f"{math.exp(after):.2f}"]
            for name, before, after in zip(BEHAVIOUR, found.before, found.after, strict=True)
        ],
    )
    print(f"{found.flights} of {flights} flights, of {found.policies} policies, were compared")
    print(f"written to {output}")
