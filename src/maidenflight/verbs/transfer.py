"""`Transfer`: policies in realities that they have not seen."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from maidenflight import run_folder, terminal
from maidenflight.settings import number, setting, whole
from maidenflight.verb import Output, Progress, Result
from maidenflight.verbs import shared
from maidenflight.verbs.in_realities import InRealities

if TYPE_CHECKING:
    from polars import DataFrame

    from maidenflight.verbs.policies import Policies

_FEW = 12
"""Flights that the command line prints one by one."""


class Transfer(InRealities):
    """Fly POLICIES in simulated realities that they have not seen.

    POLICIES are files or folders, ours or the authors' in files whose names begin with a control
    structure; all of one call are of one kind. Beside them fly raptor, raptor:500hz, pid and
    mellinger of the firmware, networks in ONNX or of Stable-Baselines3 that a TOML file describes,
    and .zip files of the latter that maidenflight.integrations.gym trained.
    """

    output = Output(run_folder.TRANSFER, "Folder for the flights.")

    trials: int = setting(whole(1, 1000), 3, "Flights of each policy in each reality.")
    duration: float = setting(number(0.1, 600.0), 20.0, "Longest flight [s].")
    rate: int | None = setting(
        whole(1, 1000),
        None,
        "Actions a second of our policies [Hz], in place of those of their training.",
        rare=True,
    )
    seed: int = shared.seed()

    def compute(self, output: Path, progress: Progress) -> Result:
        """Flies; writes `flights.csv` with a row a flight, and every flight's log."""
        import jax

        from maidenflight import results
        from maidenflight.experiments.transfer import transfer
        from maidenflight.flights import log
        from maidenflight.simulator import tasks
        from maidenflight.verbs.policies import export_command

        realities, policies = self.find_realities(), self.load()
        task, notes = policies.choose_task(self.task)
        for note in notes:
            progress.note(note)
        progress.move(0, None, "compiling and flying")
        own = policies.own
        if self.rate is not None:
            own = [
                dataclasses.replace(
                    one, interface=dataclasses.replace(one.interface, rate=self.rate)
                )
                for one in own
            ]
        flown = transfer(
            [*own, *policies.foreign],
            realities,
            self.trials,
            jax.random.key(self.seed),
            task=tasks.TASKS[task](),
            duration=self.duration,
            names=policies.names,
        )
        record = self.make_record(
            policies.inputs,
            task=task,
            reality=[place.name for place in realities],
            **policies.record,
        )
        logs = [log.write(output / f"{one.name}.csv", one, record) for one in flown.flights]
        results.remove_older(logs, record)
        table = run_folder.FLIGHTS.write(output / run_folder.FLIGHTS.name, flown.table)
        summary = summarize(flown.table)
        best = best_policy(flown.table, policies)
        notes += describe_limit_cycles(summary)

        def show() -> None:
            if flown.table.height <= _FEW:
                show_flights(flown.table)
            _show_summary(summary)
            if best and len(policies.files) > 1:
                print(
                    f"best: {best} (longest mean flight; among equals no limit cycle and the "
                    "smallest mean error)"
                )
            print(f"written to {output}/, a row a flight in flights.csv")

        return Result(
            content={
                "flights": flown.table.to_dicts(),
                "summary": summary.to_dicts(),
                "best": str(best) if best else None,
                "task": task,
                "notes": notes,
                "simulated": True,
                "output": str(output),
            },
            show=show,
            written={"flights": [table], "flight_logs": logs},
            read={"policies": policies.inputs},
            record=record,
            rows=summary.to_dicts(),
            notes=notes,
            next=export_command(best, policies.policy_of(best)) if best else (),
            value=flown,
        )


def best_policy(flights: "DataFrame", policies: "Policies") -> Path | None:
    """Returns the policy of ours that flew longest and, among equals, closest.

    One in a limit cycle is chosen for want of another only; None where others' alone flew.
    """
    import polars

    from maidenflight.experiments.transfer import LIMIT_CYCLE

    if not policies.files:
        return None
    own = flights.filter(polars.col("policy").is_in(policies.own_names))
    order = own.group_by("policy").agg(
        polars.col("duration").mean(),
        polars.col("position_error").mean(),
        (polars.col("command_change").mean() > LIMIT_CYCLE).alias("limit_cycle"),
    )
    keys = ["duration", "limit_cycle", "position_error", "policy"]
    name = order.sort(keys, descending=[True, False, False, False])["policy"][0]
    return policies.path_of(name)


def summarize(flights: "DataFrame") -> "DataFrame":
    """Returns flights, those that reached the time limit, mean duration [s] and error [m].

    A row a policy and reality.
    """
    import polars

    return flights.group_by("policy", "reality", maintain_order=True).agg(
        polars.len().alias("flights"),
        (polars.col("end_reason") == "time limit").sum().alias("time_limit"),
        polars.col("duration").mean(),
        polars.col("position_error").mean(),
        polars.col("command_change").mean(),
        polars.col("at_limits").mean(),
    )


def describe_limit_cycles(summary: "DataFrame") -> list[str]:
    """Returns a sentence on each policy and reality whose motors are thrown between their limits.

    Args:
        summary: what `summarize` returns.
    """
    from maidenflight.experiments.transfer import LIMIT_CYCLE

    return [
        f"{row['policy']} in {row['reality']} changes its commands by {row['command_change']:.2f} "
        f"of full thrust in 10 ms, {100 * row['at_limits']:.0f} % of them at a limit: a limit "
        "cycle, which wears motors and seldom survives on a real drone. Identify the drone from "
        "its flights, or train with its latency."
        for row in summary.iter_rows(named=True)
        if row["command_change"] > LIMIT_CYCLE
    ]


def show_flights(flights: "DataFrame") -> None:
    """Prints a line for each zero-shot flight."""
    rows = [
        [
            *(str(row[name]) for name in ("flight", "policy", "reality", "trial")),
            f"{row['duration']:.2f} s",
            row["end_reason"],
            f"{row['position_error'] * 100:.1f} cm",
            f"{row['command_change']:.3f}",
        ]
        for row in flights.iter_rows(named=True)
    ]
    columns = ["flight", "policy", "reality", "trial", "duration", "ended by", "error"]
    title = "Zero-shot flights, simulated; error: mean distance from the set-point; u: in 10 ms"
    terminal.print_table(title, [*columns, "change of u"], rows, numbers_from=3)


def _show_summary(summary: "DataFrame") -> None:
    """Prints a line for each policy and reality."""
    rows = [
        [
            *(row["policy"], row["reality"]),
            f"{row['time_limit']} of {row['flights']}",
            f"{row['duration']:.2f} s",
            f"{row['position_error'] * 100:.1f} cm",
            f"{row['command_change']:.3f}",
        ]
        for row in summary.iter_rows(named=True)
    ]
    columns = ["policy", "reality", "reached the time limit", "mean duration", "mean error"]
    title = (
        "Zero-shot flights by policy, simulated; error: distance from the set-point; u: in 10 ms"
    )
    terminal.print_table(title, [*columns, "change of u"], rows, numbers_from=2)
