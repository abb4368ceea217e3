"""`Predict`: how long policies would fly on the real drone."""

from collections import Counter
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight import names, run_folder, terminal
from maidenflight.settings import number, path, setting, whole
from maidenflight.verb import Output, Progress, Result, Verb
from maidenflight.verbs import logs, shared

if TYPE_CHECKING:
    from polars import DataFrame


class Predict(Verb):
    """Predict how long POLICIES would fly on the real drone.

    POLICIES are files or folders. Those of maidenflight and of Gronauer et al., of all control
    structures together, fly the circle on the identified drone as the authors' drone ran them: at
    their rate, by its firmware, from hover, until a guard trips. All of it is simulated.
    """

    output = Output(run_folder.PREDICTION.name, "CSV file for the flights, one row each.")
    parallel = True

    policies: tuple[str, ...] = shared.policies()
    drone: str = shared.drone(run_folder.DRONE, "Identified drone: a TOML file or a name.")
    randomize: float | str | None = setting(
        shared.width_or(names.TRIMS, names.POSTERIOR),
        None,
        "trim: constant torques and thrust differ as between the identified flights, the default "
        "where the drone's file tells how; posterior: drones drawn from its posterior; or the half "
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
    control: str | None = shared.control_of_authors()
    firmware: str = shared.firmware(
        "2021.10 as the authors' drone ran it, or 2026.08, for which attitude-rate and attitude "
        "policies of ours are trained."
    )
    seed: int = shared.seed()

    def check_early(self) -> None:
        """Refuses a drone that is not there."""
        shared.must_exist(self.drone)

    def check(self) -> None:
        """Refuses what is no drone or no policy."""
        from maidenflight.experiments.drones import read_drone
        from maidenflight.identification.outcome.ensembles import posterior_ensemble
        from maidenflight.verbs.policies import read_policies

        if self.get("drone"):
            file = read_drone(self.drone, self.accept_bounds)
            if self.randomize == names.POSTERIOR:
                posterior_ensemble(file.parameters, file.posterior, file.name)
        if self.get("policies"):
            read_policies(self.policies, self.control)

    def compute(self, output: Path, progress: Progress) -> Result:
        """Predicts; writes a row a flight."""
        import jax

        from maidenflight.experiments.as_flown import FIRMWARE, controller_as_flown
        from maidenflight.experiments.drones import choose_prediction, possible_drones
        from maidenflight.experiments.flight_times import predict_flight_times, summary
        from maidenflight.simulator import control
        from maidenflight.verbs.policies import export_command, read_policies

        policies = read_policies(self.policies, self.control)
        _, notes = policies.choose_task("circle")
        for note in notes:
            progress.note(note)
        progress.move(0, None, "compiling")
        usual = choose_prediction(self.drone)
        randomization = usual if self.randomize is None else self.randomize
        flown = predict_flight_times(
            policies.own,
            possible_drones(self.drone, randomization, self.seed, self.today),
            jax.random.key(self.seed),
            trials=self.trials,
            duration=self.duration,
            controller_for=controller_as_flown
            if self.firmware == FIRMWARE
            else partial(control.controller_for, firmware=self.firmware),
            names=policies.own_names,
            on_policy=lambda done, of: progress.move(done, of, "policies flown"),
        )
        inputs = [*logs.own_files(self.drone), *policies.paths]
        record = self.make_record(inputs, policies=None, randomize=randomization)
        run_folder.PREDICTION.write(output, flown, record)
        means = summary(flown)
        longest = round(means["mean"].max(), 6)  # type: ignore[arg-type]
        best = [
            path
            for path, mean in zip(policies.paths, means["mean"], strict=True)
            if round(mean, 6) == longest
        ]

        def show() -> None:
            _show(means, flown)
            if len(policies.paths) > 1:
                found = ", ".join(map(str, best))
                print(f"best: {found} (longest mean, {longest:.2f} s)")
            print(f"written to {output}")

        return Result(
            content={
                "policies": _to_content(policies.paths, means, flown),
                "best": str(best[0]),
                "notes": notes,
                "simulated": True,
                "output": str(output),
            },
            show=show,
            written={"prediction": [output]},
            read={"drone": logs.own_files(self.drone), "policies": policies.paths},
            record=record,
            rows=means.to_dicts(),
            notes=notes,
            next=export_command(best[0], policies.policy_of(best[0])),
            value=flown,
        )


def _end_reasons(flown: "DataFrame") -> list[Counter[str]]:
    """Counts why flights ended, a policy each."""
    parts = flown.partition_by("policy", maintain_order=True)
    return [Counter(part["end_reason"].to_list()) for part in parts]


def _to_content(
    paths: tuple[Path, ...], means: "DataFrame", flown: "DataFrame"
) -> list[dict[str, Any]]:
    from maidenflight.experiments.flight_times import QUANTILES

    return [
        {
            "file": str(path),
            "control": row["control"],
            "mean_duration": round(row["mean"], 6),
            "quantiles": {
                f"{percent / 100:g}": round(row[f"quantile_{percent}"], 6) for percent in QUANTILES
            },
            "end_reasons": dict(ends.most_common()),
        }
        for path, row, ends in zip(
            paths, means.iter_rows(named=True), _end_reasons(flown), strict=True
        )
    ]


def _show(means: "DataFrame", flown: "DataFrame") -> None:
    """Prints predicted flight times, a line a policy."""
    rows = []
    for row, ends in zip(means.iter_rows(named=True), _end_reasons(flown), strict=True):
        usual, count = ends.most_common(1)[0]
        times = [
            f"{row[name]:.2f} s" for name in ("mean", "quantile_10", "quantile_50", "quantile_90")
        ]
        usual = f"{usual} ({count} of {ends.total()})"
        rows.append([row["policy"], row["control"], *times, usual])
    columns = ["policy", "control", "mean", "10 %", "50 %", "90 %", "most frequent end"]
    terminal.print_table("Predicted flight times, simulated", columns, rows, numbers_from=2)
