"""`Envelope`: how hard a flight may be before policies fail."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight import names, results, run_folder
from maidenflight.errors import InputError
from maidenflight.settings import choice, flag, plain, setting, several, whole
from maidenflight.terminal import Table
from maidenflight.verb import Output, Progress, Result, Row
from maidenflight.verbs import shared
from maidenflight.verbs.parts.in_realities import InRealities

if TYPE_CHECKING:
    from polars import DataFrame


class Envelope(InRealities):
    """Find how hard a flight may be before POLICIES fail.

    A flight succeeds while its mean distance from the set-point is at most 10 cm and no guard
    trips; the envelope is what 95 % of flights reach, about the task that the policies were trained
    for. Its speed grows within a flight; each grade of another condition is a flight of 20 s.
    """

    output = Output("envelope", "Folder for the results.")
    resumable_from = run_folder.ENVELOPE.name

    along: tuple[str, ...] | None = setting(
        several(choice(*names.AXES)),
        None,
        "What grows harder: speed on the task's own path, a circle or a figure-eight; of virtual "
        "drones gusts, payload, an emptier battery, a damaged propeller, latency; may be repeated.",
        usual="speed and gusts",
    )
    flights: int = setting(whole(1, 1000), 20, "Flights of each policy along each axis.")
    resume: bool = setting(
        flag(), False, "Go on with what was interrupted in the folder.", recorded=False
    )
    seed: int = shared.seed()

    def check_early(self) -> None:
        """Refuses speed along a reference that ends."""
        super().check_early()
        if self.reference is not None and "speed" in (self.along or ()):
            raise InputError("--along speed: a reference ends before it grows; leave one out.")

    def compute(self, output: Path, progress: Progress) -> Result:
        """Flies; writes `envelope.csv`, whole again after each axis, and a picture."""
        import polars

        from maidenflight.experiments import envelope
        from maidenflight.reporting.figures.envelope import envelope as envelope_figure
        from maidenflight.reporting.figures.picture import svg
        from maidenflight.simulator.tasks.tasks import find_task

        fleet, (task, notes) = self.fleet, self.fleet.choose_task(self.chosen_task)
        record = plain(self.make_flight_record(task, within=envelope.WITHIN_M))
        path = output / run_folder.ENVELOPE.name
        parts = _read_parts(path, record) if self.resume else {}
        axes = dict.fromkeys(self.along or envelope.choose_axes(task))
        plan = [(reality, axis) for reality in self.realities for axis in axes]
        for number, (reality, axis) in enumerate(plan):
            if (reality.name, axis) in parts:
                continue
            progress.move(number, len(plan), f"{axis} in {reality.name}")
            parts[reality.name, axis] = envelope.envelope(
                fleet.every,
                reality,
                axis,
                flights=self.flights,
                key=self.key,
                task=find_task(task),
                names=fleet.names,
            )
            run_folder.ENVELOPE.write(path, polars.concat(parts.values()), record)
        all_rows = polars.concat(parts[reality.name, axis] for reality, axis in plan)
        run_folder.ENVELOPE.write(path, all_rows, record)
        summary = envelope.summary(all_rows)
        picture = results.write(path.with_suffix(".svg"), svg(envelope_figure(summary)))
        rows = summary.to_dicts()
        return self.conclude(
            {"envelope": rows},
            [_tabulate(rows)],
            all_rows.with_columns(
                duration=polars.col("reached").fill_nan(0.0) / polars.col("hardest")
            ),
            output,
            written={"envelope": [path], "picture": [picture]},
            read={"policies": fleet.inputs},
            record=record,
            rows=summary.select(polars.exclude(polars.List)).to_dicts(),
            notes=notes,
            value=all_rows,
        )


def _read_parts(path: Path, record: dict[str, Any]) -> "dict[tuple[str, str], DataFrame]":
    """Reads what an interrupted run has left, by reality and axis."""
    if not path.is_file():
        return {}
    rows, file_record = run_folder.ENVELOPE.read(path)
    if file_record != record:
        raise InputError(
            f"{path}: of other policies, settings or another version. Give another folder (-o), or "
            "--overwrite instead of --resume."
        )
    return {
        (str(reality), str(axis)): part
        for (reality, axis), part in rows.group_by("reality", "axis", maintain_order=True)
    }


def _tabulate(summary: list[Row]) -> Table:
    columns = {
        **{"policy": "{policy}", "reality": "{reality}", "along": "{axis}"},
        **{"envelope": "{envelope:.3g}", "95 %": "{low:.3g} to {high:.3g}"},
        **{"median": "{median:.3g}", "physics": "{limit:.3g}", "unit": "{unit}"},
    }
    title = "95 % of simulated flights stay within 10 cm; -: not even at the easiest"
    rows = [{**row, "limit": row["limit"] if row["limit"] > 0 else None} for row in summary]
    return Table(title, columns, rows)
