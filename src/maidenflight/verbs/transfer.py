"""`Transfer`: policies in unseen realities."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from maidenflight import names, run_folder
from maidenflight.settings import choice, number, setting, several, whole
from maidenflight.terminal import Table
from maidenflight.verb import Output, Progress, Result, Row
from maidenflight.verbs import shared
from maidenflight.verbs.parts.in_realities import InRealities

_FEW = 12
"""Flights that the command line prints one by one."""


class Transfer(InRealities):
    """Fly POLICIES in unseen simulated realities.

    POLICIES are files or folders, ours or the authors' in files whose names begin with a control
    structure; all of one call are of one kind. Beside them fly raptor, raptor:500hz, pid and
    mellinger of the firmware, networks in ONNX or of Stable-Baselines3 that a TOML file describes,
    and .zip files of the latter that maidenflight.integrations.gym trained.
    """

    output = Output(run_folder.TRANSFER, "Folder for the flights.")

    trials: int = setting(whole(1, 1000), 3, "Flights of each policy in each reality.")
    duration: float = setting(number(0.1, 600.0), 20.0, "Longest flight [s].")
    against: tuple[str, ...] = setting(
        several(choice(*names.CONTROLLERS), empty=True),
        names.CONTROLLERS[:1],
        "Controllers of the firmware that fly the same, beside the policies; may be repeated.",
        rare=True,
    )
    rate: int | None = setting(
        whole(1, 1000),
        None,
        "Actions a second of our policies [Hz], in place of those of their training.",
        rare=True,
    )
    seed: int = shared.seed()

    def compute(self, output: Path, progress: Progress) -> Result:
        """Flies; writes `flights.csv` with a row a flight, and every flight's log."""
        import polars

        from maidenflight.experiments import comparison, drones
        from maidenflight.experiments.transfer import fly_firmware, transfer
        from maidenflight.simulator.tasks.tasks import find_task
        from maidenflight.verbs.parts import logs_output

        fleet, own = self.fleet, self.fleet.own
        task, notes = fleet.choose_task(self.chosen_task)
        progress.move(0, None, "compiling and flying")
        if self.rate is not None:
            own = [
                replace(policy, interface=replace(policy.interface, rate=self.rate))
                for policy in own
            ]
        flying: Any = self.realities, self.trials, self.key
        longest = self.longest(task, self.duration)
        how: Any = {"task": find_task(task), "duration": longest}
        evaluation = transfer([*own, *fleet.foreign], *flying, names=fleet.names, **how)
        counts = {"counts": own[0].interface.full_scale_counts} if own else {}
        rivals, left_out = fly_firmware(self.against, *flying, **counts, **how)
        record = self.make_flight_record(task)
        logs = logs_output.write_logs(
            output, {flight.name: flight for flight in evaluation.flights}, record
        )
        table = run_folder.FLIGHTS.write(output / run_folder.FLIGHTS.name, evaluation.table)
        flights, summary = evaluation.table.to_dicts(), comparison.summarize(evaluation.table)
        rival_rows = [comparison.summarize(table) for table in rivals]
        notes += comparison.describe_limit_cycles(polars.concat([summary, *rival_rows]))
        if rivals or any(policy.interface.name != "pwm" for policy in own):
            notes += drones.describe_unstable(self.realities, *counts.values())
        notes += comparison.describe_margins(summary) + left_out
        rows = summary.to_dicts()
        against = [row for table in rival_rows for row in table.to_dicts()]
        return self.conclude(
            {"flights": flights, "summary": rows, "against": against},
            [
                *([tabulate_flights(flights)] if len(flights) <= _FEW else []),
                _tabulate([*rows, *against]),
                *([_RIVALS] if against else []),
            ],
            evaluation.table,
            output,
            written={"flights": [table], "flight_logs": logs},
            read={"policies": fleet.inputs},
            record=record,
            rows=rows,
            notes=notes,
            value=evaluation,
        )


_TITLE = (
    "error: mean distance from the set-point, true and as the drone estimates it; largest tilt and "
    "rate, guards' limits"
)
_RIVALS = (
    "(firmware): ended 60 cm from the set-point, policies 25 cm; pid gets positions alone and lags "
    "behind, --against mellinger gets the whole reference"
)
_MEASURES = {
    **shared.ERRORS,
    shared.CHANGE: "{command_change:.3f}",
    **shared.LARGEST,
}


def tabulate_flights(flights: list[Row]) -> Table:
    """Returns a table of zero-shot flights."""
    columns = {name: f"{{{name}}}" for name in ("flight", "policy", "reality", "trial")}
    columns |= {"duration": "{duration:.2f s}", "ended by": "{end_reason}", **_MEASURES}
    title = f"Zero-shot flights, simulated; {_TITLE}"
    return Table(title, columns, flights, (*shared.RARE, "trial"))


def _tabulate(summary: list[Row]) -> Table:
    columns = {
        "policy": "{policy}",
        "reality": "{reality}",
        "reached the time limit": "{time_limit} of {flights}",
        "mean duration": "{duration:.2f s}",
        **_MEASURES,
    }
    title = f"Zero-shot flights by policy, simulated; {_TITLE}"
    return Table(title, columns, summary, shared.RARE)
