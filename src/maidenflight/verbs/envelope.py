"""`Envelope`: how hard a flight may be before policies do not fly it."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight import names, run_folder, terminal
from maidenflight.errors import InputError
from maidenflight.settings import choice, flag, setting, several, whole
from maidenflight.verb import Output, Progress, Result
from maidenflight.verbs import shared
from maidenflight.verbs.in_realities import InRealities

if TYPE_CHECKING:
    from polars import DataFrame

    from maidenflight.verbs.policies import Policies


class Envelope(InRealities):
    """Find how hard a flight may be before POLICIES do not fly it.

    A flight is flown while its mean distance from the set-point is at most 10 cm and no guard
    trips; the envelope is what 95 % of flights reach. Speed grows within a flight, on a reference
    that gets faster; each grade of another condition is a flight of 20 s of what the policies were
    trained for. raptor and policies by others fly as in transfer. All of it is simulated.
    """

    output = Output("envelope", "Folder for the results.")
    resumable_from = run_folder.ENVELOPE.name

    along: tuple[str, ...] = setting(
        several(choice(*names.AXES)),
        names.AXES[:2],
        "What grows harder: speed on a circle or a figure-eight, gusts, payload, an emptier "
        "battery, a damaged propeller, latency; may be repeated. Conditions other than speed are "
        "for virtual drones.",
    )
    flights: int = setting(whole(1, 1000), 20, "Flights of each policy along each axis.")
    resume: bool = setting(
        flag(), False, "Go on with what was interrupted in the folder.", recorded=False
    )
    seed: int = shared.seed()

    def compute(self, output: Path, progress: Progress) -> Result:
        """Flies; writes `envelope.csv`, whole again after each axis, and a picture."""
        import jax
        import polars

        from maidenflight import results
        from maidenflight.experiments import envelope
        from maidenflight.reporting.figures import envelope as envelope_figures
        from maidenflight.reporting.figures.picture import svg
        from maidenflight.simulator import tasks
        from maidenflight.verbs.policies import export_command

        realities, policies = self.find_realities(), self.load()
        task, notes = policies.choose_task(self.task)
        for note in notes:
            progress.note(note)
        axes = tuple(dict.fromkeys(self.along))
        record = results.plain(
            self.make_record(
                policies.inputs,
                task=task,
                reality=[place.name for place in realities],
                within=envelope.WITHIN_M,
                **policies.record,
            )
        )
        path = output / run_folder.ENVELOPE.name
        parts = _read_parts(path, record) if self.resume else {}
        plan = [(place, axis) for place in realities for axis in axes]
        for number, (place, axis) in enumerate(plan):
            if (place.name, axis) in parts:
                continue
            progress.move(number, len(plan), f"{axis} in {place.name}")
            parts[place.name, axis] = envelope.envelope(
                policies.every,
                place,
                axis,
                flights=self.flights,
                key=jax.random.key(self.seed),
                task=tasks.TASKS[task](),
                names=policies.names,
            )
            run_folder.ENVELOPE.write(path, polars.concat(parts.values()), record)
        flown = polars.concat(parts[place.name, axis] for place, axis in plan)
        run_folder.ENVELOPE.write(path, flown, record)
        summary = envelope.summary(flown)
        drawn = svg(envelope_figures.envelope(summary))
        picture = results.write(path.with_suffix(".svg"), drawn)
        best = best_policy(summary, policies)

        def show() -> None:
            _show(summary)
            if best and len(policies.files) > 1:
                print(f"best: {best} (greatest mean share of all axes)")
            print(f"written to {output}/, a row a flight in {path.name}, and a picture")

        return Result(
            content={
                "envelope": summary.to_dicts(),
                "best": str(best) if best else None,
                "task": task,
                "notes": notes,
                "simulated": True,
                "output": str(output),
            },
            show=show,
            written={"envelope": [path], "picture": [picture]},
            read={"policies": policies.inputs},
            record=record,
            rows=summary.select(polars.exclude(polars.List)).to_dicts(),
            notes=notes,
            next=export_command(best, policies.policy_of(best)) if best else (),
            value=flown,
        )


def best_policy(summary: "DataFrame", policies: "Policies") -> Path | None:
    """Returns the policy of ours with the widest envelope, its mean share of each axis.

    Args:
        summary: what `envelope.summary` returns.
        policies: that flew.
    """
    import polars

    if not policies.files:
        return None
    own = summary.filter(polars.col("policy").is_in(policies.own_names))
    share = (polars.col("envelope").fill_nan(0.0) / polars.col("hardest")).mean()
    order = own.group_by("policy", maintain_order=True).agg(share.alias("share"))
    name = order.sort("share", descending=True, maintain_order=True)["policy"][0]
    return policies.path_of(name)


def _read_parts(path: Path, record: dict[str, Any]) -> "dict[tuple[str, str], DataFrame]":
    """Reads what an interrupted run has left, by reality and axis."""
    if not path.is_file():
        return {}
    rows, found = run_folder.ENVELOPE.read(path)
    if found != record:
        raise InputError(
            f"{path}: of other policies, settings or another version. Give another folder (-o), or "
            "--overwrite instead of --resume."
        )
    return {
        (str(place), str(axis)): part
        for (place, axis), part in rows.group_by("reality", "axis", maintain_order=True)
    }


def _show(summary: "DataFrame") -> None:
    """Prints a line for each policy, reality and axis."""
    rows = []
    for row in summary.iter_rows(named=True):
        envelope, low, high, median, limit = (
            "-" if row[name] != row[name] else f"{row[name]:.3g}"
            for name in ("envelope", "low", "high", "median", "limit")
        )
        names = [row["policy"], row["reality"], row["axis"]]
        limit = "" if limit == "-" else limit
        rows.append([*names, envelope, f"{low} to {high}", median, limit, row["unit"]])
    columns = ["policy", "reality", "along", "envelope", "95 %", "median", "physics", "unit"]
    title = "Flown within 10 cm by 95 % of flights, simulated; -: not even the easiest"
    terminal.print_table(title, columns, rows, numbers_from=3)
