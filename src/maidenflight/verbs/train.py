"""`Train`: policies for a drone."""

import dataclasses
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight import names, results, run_folder
from maidenflight.errors import InputError
from maidenflight.registry import EXPORTERS, LOGGERS, VIEWERS
from maidenflight.settings import (
    PENDING,
    choice,
    flag,
    listed,
    name_of,
    number,
    path,
    setting,
    several,
    table,
    text,
    whole,
)
from maidenflight.verb import Output, Progress, Result, Verb
from maidenflight.verbs import shared
from maidenflight.verbs.logs import own_files

if TYPE_CHECKING:
    from maidenflight.identification.drone_file import DroneFile
    from maidenflight.policy import Policy
    from maidenflight.policy_file import PolicyFile
    from maidenflight.simulator.policy_spec import PolicySpec
    from maidenflight.training.settings import Settings
    from maidenflight.training.train import Progress as Training

_FLIGHT, _SEEN, _METHOD, _WATCH = "Task", "Observation and network", "Method", "Watching"
_OF_RAPTOR = ("control", "history", "look_ahead", "look_ahead_spacing", "memory", "hidden")
"""Settings that RAPTOR's form settles."""
_OF_A_POLICY = (*_OF_RAPTOR, "paper_scales", "form")
"""Settings that the policy settles from which training starts."""


class Train(Verb):
    """Train policies for a drone.

    By gradients through the simulator, by distillation, or by PPO. What is interrupted goes on by
    the same command with --resume.
    """

    output = Output(run_folder.POLICIES, "Folder for the policies.")
    fused, parallel = True, True
    resumable_from = run_folder.CHECKPOINT
    counted = "policies"

    drone: str = shared.drone(run_folder.DRONE, "Drone to train for: a TOML file or a name.")
    changes: dict[str, float] = setting(
        table(number(-1e9, 1e9), "parameters of the drone by name, such as latency=0.02"),
        {},
        "Parameter of the drone to replace, in SI units; may be repeated.",
        name="set",
        group=shared.DRONES,
        rare=True,
    )
    randomize: float | str | None = setting(
        shared.width_or("posterior", "wide", "any-day", "any"),
        None,
        "Drones to train over: wide about the drone, its posterior, any-day with unseen trims, "
        "payload and faults, any make (both suit --memory), or a box of this half width.",
        usual="wide; any-day for attitude_rate; 0.1 for fast tasks",
    )
    accept_bounds: bool = shared.accept_bounds()
    task: str = setting(choice(*names.TASKS), "circle", "Task.", group=_FLIGHT)
    control: str = setting(choice(*names.CONTROLS), "pwm", "Control structure.", group=_FLIGHT)
    yaw_penalty: float = setting(
        number(0.0, 10.0),
        0.0,
        "Cost of a radian of yaw, per control period; 0.1 keeps the yaw near 0.",
        group=_FLIGHT,
    )
    paper_scales: bool = setting(
        flag(),
        False,
        "In attitude control, scale thrust as the paper does, from 7/12 to 11/12 of full thrust, "
        "instead of about hovering.",
        rare=True,
    )
    rate: int | None = setting(
        whole(1, 1000),
        None,
        "Actions a second in training [Hz]; the control structure's own unless given.",
        rare=True,
    )
    target: str | None = setting(
        name_of(EXPORTERS),
        None,
        "Check first that the policies can be exported to this.",
        rare=True,
        name="for",
    )
    history: int = setting(
        whole(1, 50), 2, "Last instants in an observation.", group=_SEEN, rare=True
    )
    look_ahead: int = setting(
        whole(0, 50),
        0,
        "Points of the reference ahead of time in an observation.",
        rare=True,
        group=_SEEN,
    )
    look_ahead_spacing: float = setting(
        number(0.001, 10.0), 0.1, "Time between two of these points [s].", group=_SEEN, rare=True
    )
    memory: int = setting(
        whole(0, 256),
        0,
        "Numbers that a policy remembers (GRU), such as 32, by which it adapts to trims, lag and "
        "payload.",
    )
    hidden: tuple[int, ...] | None = setting(
        listed(whole(1, 1024), "numbers from 1 to 1024, such as 50,50", "SIZES"),
        None,
        "Sizes of the hidden layers.",
        usual="50,50; 75,75 for attitude_rate",
        rare=True,
    )
    form: str = setting(
        choice(*names.FORMS),
        "instants",
        "Form of the policies. raptor: shape, observation and actions of RAPTOR's network, for "
        "export --to raptor; it has its own control structure, history, look-ahead, memory and "
        "layers.",
        rare=True,
    )
    initial: Path | None = setting(
        path(metavar="POLICY"),
        None,
        "Policy file to start from instead of random weights, as to fit it to today's drone in "
        "seconds; what it sees and remembers stays.",
        name="from",
        files=True,
    )
    policies: int = setting(
        whole(1, 4096), 3, "Number of policies, each with its own seed.", group=_METHOD
    )
    method: str | None = setting(
        choice(*names.METHODS),
        None,
        "Training method.",
        usual="gradient; distillation with --memory",
        rare=True,
        group=_METHOD,
    )
    updates: int | None = setting(
        whole(1, 10**6),
        None,
        "Gradient steps, or epochs of PPO.",
        usual="see docs/training.md",
    )
    learner: dict[str, float] = setting(
        table(number(0.0, 1e6), "settings of the method by name, such as num_envs=128"),
        {},
        "Setting of the method, a field of its settings in Python; may be repeated.",
        rare=True,
    )
    resume: bool = setting(
        flag(),
        False,
        "Resume an interrupted training, or with more --updates extend one that has ended.",
        recorded=False,
    )
    log: tuple[str, ...] = setting(
        several(name_of(LOGGERS), empty=True),
        (),
        "Log evaluations while training runs: event files in OUTPUT/tensorboard, or Weights & "
        "Biases. May be repeated.",
        group=_WATCH,
        rare=True,
    )
    view: str | None = setting(
        text(metavar="FILE"),
        None,
        "Show evaluations and flights of the best policy while training runs: in rerun's viewer, "
        "or in an .rrd FILE for it.",
        rare=True,
        recorded=False,
        bare=".",
    )
    seed: int = shared.seed()

    def check_early(self) -> None:
        """Refuses a drone that is not there, and what something else settles."""
        shared.must_exist(self.drone)
        start, raptor = self.initial is not None, self.form == "raptor"
        by_start = "the policy of --from has its own"
        shared.must_be_default(self, _OF_A_POLICY if start else (), by_start)
        shared.must_be_default(self, _OF_RAPTOR if raptor else (), "--form raptor has its own")

    def check(self) -> None:
        """Refuses what is no drone or no policy, and settings of no method."""
        from maidenflight.experiments import drones

        if self.drone is not PENDING:
            drones.read_drone(self.drone, self.accept_bounds)
        start = self._read_start()
        self.choose_learner(self.choose_spec(start), start)

    def _read_start(self) -> "PolicyFile | None":
        from maidenflight import policy_file

        return None if self.initial is None else policy_file.read(self.initial)

    def choose_spec(self, start: "PolicyFile | None") -> "PolicySpec":
        """Returns what the policies see and remember, and their layers."""
        from maidenflight.simulator.look_ahead import LookAhead
        from maidenflight.simulator.policy_spec import PolicySpec
        from maidenflight.training import defaults

        if start is not None:
            return start.spec
        ahead = LookAhead(self.look_ahead, self.look_ahead_spacing)
        spec = PolicySpec(self.history, ahead, self.memory, form=self.form)
        method = self.method or defaults.choose_method(spec, initial=False)
        hidden = self.hidden or defaults.choose_hidden(self.control, method)
        return dataclasses.replace(spec, hidden=hidden)

    def choose_learner(self, spec: "PolicySpec", start: "PolicyFile | None") -> "Settings":
        """Returns the settings of the method.

        Raises:
            InputError: the method does not train such policies, or has no such setting.
        """
        from maidenflight.training import defaults

        control = self._choose_control(start)
        method = self.method or defaults.choose_method(spec, start is not None)
        chosen: Any = defaults.choose_settings(control, self.task, method, spec, start is not None)
        fields = {field.name: getattr(chosen, field.name) for field in dataclasses.fields(chosen)}
        changed: dict[str, Any] = {} if self.updates is None else {"updates": self.updates}
        for name, value in self.learner.items():
            if type(fields.get(name)) not in (int, float):
                raise InputError(f"learner: {name} is no number of {method}: {', '.join(fields)}.")
            whole_number = isinstance(fields[name], int)
            if whole_number and value != int(value):
                raise InputError(f"learner: {name} = {value:g}; expected a whole number.")
            changed[name] = int(value) if whole_number else value
        return dataclasses.replace(chosen, **changed)

    def compute(self, output: Path, progress: Progress) -> Result:
        """Trains; writes a JSON a policy, `training.csv` with their scores, and a checkpoint."""
        import jax

        from maidenflight.training import checkpoint, loggers
        from maidenflight.training.settings import recorded
        from maidenflight.verbs import training_files as files

        saved = output / run_folder.CHECKPOINT
        if self.resume and not saved.exists():
            raise InputError(f"{saved}: no training to resume. {files.how_to_start(output)}")
        start = self._read_start()
        spec = self.choose_spec(start)
        learner: Any = self.choose_learner(spec, start)
        if self.resume and self.updates is None:
            learner = dataclasses.replace(learner, updates=max(checkpoint.stages(saved)))
        keys = jax.random.split(jax.random.key(self.seed), self.policies)
        scores = files.Scores(progress, learner, self.resume)
        record = self.make_record(
            own_files(self.drone, self.initial),
            control=self._choose_control(start),
            randomize=self._choose_randomization(start),
            paper_scales=self._has_paper_scales,
            method=type(learner).__name__,
            **(spec.to_dict() | {"look_ahead": spec.look_ahead.points}),
            look_ahead_spacing=spec.look_ahead.spacing,
            **recorded(learner),
        )
        for left in results.leftovers(output) if output.is_dir() else ():
            left.unlink(missing_ok=True)
        with (
            loggers.opened(self.log, output, self.policies, record["settings"]) as show,
            self._watched() as watch,
        ):

            def on_progress(now: "Training") -> None:
                for listener in (show, scores.add, watch):
                    listener(now)

            progress.move(0, learner.updates, "compiling, until the first score")
            policies, drone = self._train(spec, learner, keys, start, saved, on_progress)
        if len(stages := checkpoint.stages(saved)) > 1:
            record["settings"]["extended_from"] = list(stages[:-1])
        written = files.write_policies(output, policies, record, drone, scores.rows)
        best = scores.best
        return Result(
            content={"policies": [str(path) for path in written["policies"]], "scores": best},
            show=lambda: files.show_scores(best, output),
            written=written,
            read={"drone": own_files(self.drone)},
            record=record,
            rows=[{"policy": f"policy_{number}", **one} for number, one in enumerate(best, 1)],
            next=("transfer", output, "--drone", self.drone),
            value=policies,
        )

    def _choose_control(self, start: "PolicyFile | None") -> str:
        return self.control if start is None else start.interface.name

    def _choose_randomization(self, start: "PolicyFile | None") -> float | str:
        from maidenflight.training import defaults

        usual = defaults.choose_randomization(self.task, self._choose_control(start))
        return usual if self.randomize is None else self.randomize

    @property
    def _has_paper_scales(self) -> bool:
        """Returns whether actions are scaled as the paper does, which the authors' format needs."""
        return self.paper_scales or self.target == "authors"

    def _train(
        self,
        spec: "PolicySpec",
        learner: "Settings",
        keys: Any,
        start: "PolicyFile | None",
        saved: Path,
        on_progress: Callable[["Training"], None],
    ) -> "tuple[tuple[Policy, ...], DroneFile]":
        """Trains over the drones that the settings say."""
        import numpy as np

        from maidenflight import parameters
        from maidenflight.deployment.check import check_export
        from maidenflight.experiments import drones
        from maidenflight.simulator import tasks
        from maidenflight.training import defaults
        from maidenflight.training.train import train

        file = drones.read_drone(self.drone, self.accept_bounds)
        changed = {name: np.float32(value) for name, value in self.changes.items()}
        drone = parameters.check(parameters.replace(file.parameters, **changed), self.drone)
        file = dataclasses.replace(file, parameters=drone)
        initial = None if start is None else start.policy
        controller = defaults.choose_controller(
            self._choose_control(start),
            *(drone, file.full_scale_counts, initial, self._has_paper_scales, self.rate),
        )
        if self.target is not None:
            check_export(self.target, controller.interface, spec, file.parameters)
        task = tasks.TASKS[self.task]()
        policies = train(
            tasks.with_yaw_penalty(task, self.yaw_penalty) if self.yaw_penalty else task,
            controller,
            drones.distribution_of(file, self._choose_randomization(start), controller),
            keys,
            learner,
            spec=spec,
            on_progress=on_progress,
            saved=saved,
            anew=not self.resume,
            initial=initial,
        )
        return policies, file

    @contextmanager
    def _watched(self) -> "Iterator[Callable[[Training], None]]":
        """Shows each evaluation in rerun, where `view` asks for it."""
        if self.view is None:
            yield lambda progress: None
            return
        from maidenflight.verbs.training_files import fly_watched

        fly = partial(fly_watched, self.drone, self.task)
        with VIEWERS["training"](fly, None if self.view == "." else Path(self.view)) as watch:
            yield watch

    def discard_state(self, output: Path) -> None:
        """Removes the checkpoint, which is larger than the policies."""
        (output / run_folder.CHECKPOINT).unlink(missing_ok=True)
