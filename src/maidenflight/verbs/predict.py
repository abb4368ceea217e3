"""`Predict`: how long policies would fly on the real drone."""

from collections import Counter
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight import names, results, run_folder
from maidenflight.settings import number, path, setting, several, text, whole
from maidenflight.terminal import Table
from maidenflight.verb import Output, Progress, Result, Row
from maidenflight.verbs import shared
from maidenflight.verbs.parts.in_realities import FliesPolicies, export_command

if TYPE_CHECKING:
    from polars import DataFrame

    from maidenflight.experiments.policies import Policies
    from maidenflight.experiments.verdict import Verdict
    from maidenflight.parameters import Parameters


class Predict(FliesPolicies):
    """Predict how long POLICIES would fly on the real drone.

    POLICIES are files or folders. Those of maidenflight and of Gronauer et al., of all control
    structures together, fly on the identified drone: at their rate, by today's firmware, from
    hover, until a guard of the app trips. Each flies the task of its training, the authors' the
    paper's circle. Errors are true and as the drone estimates them; largest values are by the
    estimates, which guards look at. All of it is simulated.
    """

    output = Output(run_folder.PREDICTION.name, "CSV file for the flights, one row each.")
    parallel = True

    drone: str = shared.drone(run_folder.DRONE, "Identified drone: a TOML file or a name.")
    randomize: float | str | None = setting(
        shared.width_or(names.TRIMS, names.POSTERIOR),
        None,
        "trim: constant torques and thrust differ as between the identified flights, the default "
        "where the drone's file says how; posterior: drones drawn from its posterior; or the half "
        "width of the parameters' box, 0 for the drone as it is.",
    )
    today: Path | None = setting(
        path("a log or a folder of them", "LOGS"),
        None,
        "A log or folder of flights of today, by any controller: trims and thrust are theirs.",
        files=True,
    )
    accept_bounds: bool = shared.accept_bounds()
    trials: int = setting(whole(1, 1000), 16, "Flights of each policy.", shared.FLIGHTS)
    duration: float = setting(number(0.1, 600.0), 20.0, "Longest flight [s].")
    conditions: Path | None = shared.conditions()
    against: tuple[str, ...] = setting(
        several(text("pid, mellinger, a policy file or a folder of them", "NAME"), empty=True),
        names.CONTROLLERS,
        "What flies beside them, on the drone as it is and changed: pid and mellinger of the "
        "firmware, or policies of another drone, which also fly that one if it is a named drone; "
        "may be repeated.",
    )
    seed: int = shared.seed()

    def check(self) -> None:
        """Refuses what is no drone, too."""
        from maidenflight.experiments import drones
        from maidenflight.experiments.conditions import read_conditions

        read_conditions(self.conditions)
        if self.get("drone"):
            file = drones.read_drone(self.drone, self.accept_bounds)
            if self.randomize == names.POSTERIOR:
                _ = file.ensemble
        super().check()
        _ = self.others

    def compute(self, output: Path, progress: Progress) -> Result:
        """Predicts; writes a row a flight."""
        from maidenflight.experiments import comparison, drones, flight_times
        from maidenflight.experiments.conditions import read_conditions
        from maidenflight.experiments.rivals import describe_changes
        from maidenflight.simulator.tasks.tasks import find_task

        fleet, (tasks, notes) = self.fleet, self.fleet.choose_tasks(self.chosen_task)
        progress.move(0, None, "compiling")
        usual = drones.choose_prediction(self.drone)
        randomization = usual if self.randomize is None else self.randomize
        drawn_drones = drones.possible_drones(self.drone, randomization, self.seed, self.today)
        prediction = flight_times.predict_flight_times(
            fleet.own,
            drawn_drones,
            self.key,
            trials=self.trials,
            duration=self.longest(tasks[0], self.duration),
            conditions=read_conditions(self.conditions),
            names=fleet.own_names,
            policy_tasks=[find_task(task) for task in tasks],
            on_policy=lambda done, of: progress.move(done, of, "policies flown"),
        )
        drone = shared.own_files(self.drone)
        files = [*drone, *shared.own_files(self.conditions), *fleet.paths, *self.others.paths]
        record = self.make_record(files, policies=None, randomize=randomization)
        progress.move(0, None, "flying the drone changed, and others beside")
        table, more = self._fly_rivals(tasks, self.longest(tasks[0], self.duration))
        notes += more
        verdicts = self._judge(prediction, drawn_drones, self.longest(tasks[0], self.duration))
        verdicts = {
            path: replace(
                verdict, sentence=verdict.sentence + describe_changes(table, name, self.changed)
            )
            for (path, verdict), name in zip(verdicts.items(), fleet.own_names, strict=True)
        }
        record["verdicts"] = [
            {"policy": results.digest(path), "good": verdict.is_good, "sentence": verdict.sentence}
            for path, verdict in verdicts.items()
        ]
        run_folder.PREDICTION.write(output, prediction, record)
        parts = prediction.partition_by("policy", maintain_order=True)
        ends = [Counter(part["end_reason"].to_list()) for part in parts]
        summary = flight_times.summary(prediction)
        rows, beside = summary.to_dicts(), table.to_dicts()
        means = [round(row["mean"], 6) for row in rows]
        quantiles = {f"{level / 100:g}": f"quantile_{level}" for level in flight_times.QUANTILES}
        outlives = flight_times.outlives(prediction)
        against_best = outlives[:, max(range(len(rows)), key=lambda index: rows[index]["mean"])]
        policies = [
            {
                "file": str(path),
                "control": row["control"],
                "task": task,
                "mean_duration": mean,
                **{name: row[name] for name in (*comparison.ERRORS, *comparison.LARGEST)},
                "quantiles": {share: round(row[name], 6) for share, name in quantiles.items()},
                "end_reasons": dict(reasons.most_common()),
                "outlives": dict(zip(summary["policy"], chances.round(3).tolist(), strict=True)),
                "good": verdicts[path].is_good,
                "verdict": verdicts[path].sentence,
            }
            for path, task, row, mean, reasons, chances in zip(
                fleet.paths, tasks, rows, means, ends, outlives, strict=True
            )
        ]
        known = drones.read_file(self.drone)
        by_firmware = any(policy.interface.name != "pwm" for policy in fleet.own)
        loop = [drones.describe_loop(known)] if by_firmware else []
        best = self.choose_best(prediction)
        words, remark = self._mend(best, verdicts[best], randomization) if best else ((), "")
        return self.conclude(
            {"policies": policies, "beside": beside},
            [
                _tabulate(rows, ends, against_best.tolist()),
                _tabulate_rivals(beside),
            ],
            prediction,
            output,
            written={"prediction": [output]},
            read={"drone": drone, "policies": fleet.paths},
            record=record,
            rows=rows,
            notes=[
                *notes,
                *self.describe_other_drones([self.drone]),
                *comparison.describe_margins(summary),
                *flight_times.describe_alike(summary, against_best),
                *loop,
                *drones.repeat_doubts(known),
            ],
            value=prediction,
            verdict=verdicts[best].sentence if best else "",
            next=words,
            next_remark=remark,
        )

    @cached_property
    def others(self) -> "Policies":
        """Returns the policies of another drone."""
        from maidenflight.experiments.policies import read_policies

        places = [name for name in self.against if name not in names.CONTROLLERS]
        return read_policies(places)

    @property
    def changed(self) -> dict[str, str]:
        """Returns what a sentence calls the changed drones."""
        from maidenflight.experiments import drones

        name = drones.find_reality(self.drone, self.accept_bounds).name
        words = ("10 ms more latency", "15 % payload", "a motor 10 % weaker")
        return dict(zip((f"{name}+{change}" for change in names.CHANGES), words, strict=True))

    def _fly_rivals(self, tasks: list[str], duration: float) -> "tuple[DataFrame, list[str]]":
        """Flies the drone changed, and the others beside the policies."""
        import polars

        from maidenflight.experiments import drones, rivals
        from maidenflight.experiments.conditions import read_conditions
        from maidenflight.parameters import DRONES, drone
        from maidenflight.simulator.realities.virtual_drone import VirtualDrone, must_be_virtual
        from maidenflight.simulator.tasks.tasks import find_task

        fleet, others, conditions = self.fleet, self.others, read_conditions(self.conditions)
        here = must_be_virtual(drones.find_reality(self.drone, self.accept_bounds), "")
        changed, notes = rivals.changed_drones(here)
        own = rivals.PolicySet(fleet.own_names, fleet.own, tasks)
        how: Any = self.key, duration, conditions
        parts = [rivals.fly_drones(own, [here, *changed], *how)]
        if others.own:
            known = {str(file.identity.get("name")) for file in others.files} & DRONES.keys()
            theirs = [VirtualDrone(name, drone(name)) for name in sorted(known - {here.name})]
            foreign_set = rivals.PolicySet(
                [f"against/{name}" for name in others.own_names],
                others.own,
                others.choose_tasks(self.chosen_task or tasks[0])[0],
            )
            parts.append(rivals.fly_drones(foreign_set, [here, *changed, *theirs], *how))
            parts += [rivals.fly_drones(own, theirs, *how)] if theirs else []
        controllers = [name for name in self.against if name in names.CONTROLLERS]
        counts = fleet.own[0].interface.full_scale_counts
        rows, more = rivals.fly_controllers(
            controllers, [here, *changed], self.key, counts, find_task(tasks[0]), duration
        )
        return polars.concat([*parts, *rows]), [*notes, *more]

    def _judge(
        self, prediction: "DataFrame", drawn_drones: "Parameters", seconds: float
    ) -> "dict[Path, Verdict]":
        """Judges each policy by its flights."""
        import numpy as np

        from maidenflight.experiments import drones
        from maidenflight.experiments.verdict import judge
        from maidenflight.parameters import COMPONENTS, component

        actions = {tip.parameter: tip.action for tip in drones.read_file(self.drone).advice}
        samples = {}
        if np.ndim(drawn_drones.mass):
            samples = {name: component(drawn_drones, name) for name in COMPONENTS}
        parts = prediction.partition_by("policy", maintain_order=True)
        return {
            path: judge(part, samples, seconds, actions)
            for path, part in zip(self.fleet.paths, parts, strict=True)
        }

    def _mend(
        self, best: Path, verdict: "Verdict", randomization: float | str
    ) -> tuple[tuple[object, ...], str]:
        """Returns the words of the command that exports or mends a policy, and a remark on them."""
        from maidenflight.experiments import drones

        policy = self.fleet.files[self.fleet.paths.index(best)]
        if verdict.is_good:
            return export_command(best, policy.policy), ""
        known = drones.read_file(self.drone)
        actions = {tip.parameter: tip.action for tip in known.advice}
        if verdict.parameter in actions:
            again = Path(self.drone).with_name("drone_2.toml")
            return ("identify", "LOGS", "-o", again), f"LOGS: {actions[verdict.parameter]}"
        folder = best.parent.parent / f"{run_folder.POLICIES}_2"
        if not policy.record or self.describe_other_drones([self.drone]):
            over: tuple[object, ...] = ("--control", policy.interface.name)
        else:
            width = randomization if randomization == names.POSTERIOR else names.ANY_DAY
            over = ("--from", best, "--randomize", width)
        over += ("--task", policy.task) if policy.task else ()
        yaw = policy.record.get("settings", {}).get("yaw_penalty")
        over += ("--yaw-penalty", yaw) if yaw else ()
        return ("train", "--drone", self.drone, *over, "-o", folder), ""


def _tabulate_rivals(rows: list[Row]) -> Table:
    """Returns a table of what flew beside the policies, and of them."""
    columns = {
        **{"policy": "{policy}", "drone": "{drone}"},
        **{"reached the time limit": "{time_limit} of {flights}", "mean": "{duration:.1f} s"},
        **shared.ERRORS,
        "most frequent end": "{end_reason}",
    }
    rare = ("most frequent end", "mean")
    return Table("The drone as it is and changed, simulated", columns, rows, rare)


def _tabulate(summary: list[Row], ends: list[Counter[str]], against_best: list[float]) -> Table:
    """Returns a table of flight times, with the most frequent end of each policy's flights."""
    columns = {"policy": "{policy}", "control": "{control}", "mean": "{mean:.2f s}"}
    columns |= {f"{share} %": f"{{quantile_{share}:.2f s}}" for share in (10, 50, 90)}
    columns |= {**shared.ERRORS, **shared.LARGEST}
    columns |= {"most frequent end": "{end} ({count} of {trials})"}
    columns |= {"outlives the best": "{outlives:.0%}"}
    rows = []
    for row, reasons, outlives in zip(summary, ends, against_best, strict=True):
        end, count = reasons.most_common(1)[0]
        rows.append({**row, "end": end, "count": count, "outlives": outlives})
    rare = (*shared.RARE, "control", *shared.ERRORS, "10 %", "90 %")
    return Table("Predicted flight times, simulated", columns, rows, rare)
