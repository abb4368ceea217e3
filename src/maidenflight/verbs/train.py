"""`Train`: policies for a drone."""

import dataclasses
from collections.abc import Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight import compiler, names, results, run_folder
from maidenflight.errors import InputError
from maidenflight.registry import EXPORTERS, LOGGERS
from maidenflight.settings import (
    PENDING,
    choice,
    flag,
    listed,
    name_of,
    number,
    or_code,
    path,
    setting,
    several,
    table,
    whole,
)
from maidenflight.terminal import Table
from maidenflight.verb import Output, Progress, Result, Verb
from maidenflight.verbs import shared

if TYPE_CHECKING:
    from maidenflight.identification.drone_file import DroneFile
    from maidenflight.policy import Policy
    from maidenflight.policy_file import PolicyFile
    from maidenflight.simulator.controllers.control import Controller
    from maidenflight.simulator.policy_spec import PolicySpec
    from maidenflight.training.settings import Settings
    from maidenflight.verbs.parts.training_watch import TrainingWatch

_OF_A_FORM = ("control", "history", "look_ahead", "look_ahead_spacing", "memory", "hidden")
"""Settings that a form of another program settles."""
_OF_A_POLICY = (*_OF_A_FORM, "paper_scales", "form")
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
        rare=True,
    )
    randomize: float | str | None = setting(
        or_code(shared.width_or("posterior", "wide", "any-day", "any")),
        None,
        "Drones to train over: wide about the drone, its posterior, any-day with unseen trims, "
        "payload and faults, any make (both suit --memory), a box of this half width, or what a "
        "function of your own makes of the drone.",
        usual="wide; any-day for attitude_rate; 0.1 for fast tasks",
    )
    accept_bounds: bool = shared.accept_bounds()
    task: str = setting(or_code(choice(*names.TASKS)), "circle", "Task.", group="Task")
    control: str = setting(or_code(choice(*names.CONTROLS)), "pwm", "Control structure.")
    yaw_penalty: float | None = setting(
        number(0.0, 10.0),
        None,
        "Cost of a radian of yaw, per control period.",
        usual="0; 0.1 for attitude_rate",
    )
    paper_scales: bool = setting(
        flag(),
        False,
        "Scale thrust as the paper does, in attitude control from 7/12 to 11/12 of full thrust, "
        "instead of about hovering.",
        rare=True,
    )
    rate: int | None = setting(
        whole(1, 1000),
        None,
        "Actions a second in training [Hz]; the control structure's own by default.",
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
        whole(1, 50),
        2,
        "Last instants in an observation.",
        group="Observation and network",
        rare=True,
    )
    look_ahead: int | None = setting(
        whole(0, 50),
        None,
        "Points of the reference ahead of time in an observation.",
        rare=True,
        usual="5 for tracking; none",
    )
    look_ahead_spacing: float = setting(
        number(0.001, 10.0), 0.1, "Time between two of these points [s].", rare=True
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
        "export --to raptor; px4: those of PX4's mc_nn_control, for export --to px4. Both have "
        "their own control structure, history, look-ahead, memory and layers.",
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
        whole(1, 4096), 3, "Number of policies, each with its own seed.", group="Method"
    )
    method: str | None = setting(
        choice(*names.METHODS),
        None,
        "Training method.",
        usual="gradient; distillation with --memory",
        rare=True,
    )
    updates: int | None = setting(
        whole(1, 10**6), None, "Gradient steps, or epochs of PPO.", usual="see docs/training.md"
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
        group="Watching",
        rare=True,
    )
    seed: int = shared.seed()

    def check_early(self) -> None:
        """Refuses a drone that is not there, and what something else settles."""
        shared.must_exist(self.drone)
        start, own = self.initial is not None, self.form == "instants"
        by_start = "the policy of --from has its own"
        shared.must_be_default(self, _OF_A_POLICY if start else (), by_start)
        shared.must_be_default(self, () if own else _OF_A_FORM, f"--form {self.form} has its own")

    def check(self) -> None:
        """Refuses what is no drone, task or policy, and settings of no method."""
        from maidenflight.simulator.controllers import control
        from maidenflight.simulator.tasks.tasks import find_task

        if self.drone is not PENDING:
            _ = self.drone_file
        find_task(self.task)
        control.find_controller(self.control)
        _ = self.learner_settings

    @cached_property
    def drone_file(self) -> "DroneFile":
        """Returns the drone, with the changes of `set`."""
        from numpy import float32

        from maidenflight import parameters
        from maidenflight.experiments import drones

        file = drones.read_drone(self.drone, self.accept_bounds)
        changed = {name: float32(value) for name, value in self.changes.items()}
        drone = parameters.replace(file.parameters, **changed)
        return dataclasses.replace(file, parameters=parameters.check(drone, self.drone))

    @cached_property
    def start(self) -> "PolicyFile | None":
        """Returns the policy that training starts from instead of random weights."""
        from maidenflight import policy_file

        return None if self.initial is None else policy_file.read_policy(self.initial)

    @cached_property
    def spec(self) -> "PolicySpec":
        """Returns what the policies see and remember, and their layers."""
        from maidenflight.simulator.policy_spec import PolicySpec
        from maidenflight.simulator.tasks.look_ahead import LookAhead
        from maidenflight.training import defaults

        if self.start is not None:
            return self.start.spec
        points = defaults.choose_points(self.task)
        points = points if self.look_ahead is None else self.look_ahead
        ahead = LookAhead(points, self.look_ahead_spacing)
        spec = PolicySpec(self.history, ahead, self.memory, form=self.form)
        method = self.method or defaults.choose_method(spec, initial=False)
        hidden = self.hidden or defaults.choose_hidden(self.control, method, points)
        return dataclasses.replace(spec, hidden=hidden)

    @cached_property
    def learner_settings(self) -> "Settings":
        """Returns the settings of the method."""
        from maidenflight.training import defaults
        from maidenflight.training.settings import override

        how = self._control, self.task, self._method, self.spec, self.start is not None
        updates = {} if self.updates is None else {"updates": self.updates}
        return override(defaults.choose_settings(*how), {**updates, **self.learner})

    @property
    def _control(self) -> str:
        return self.control if self.start is None else self.start.interface.name

    @property
    def _randomization(self) -> float | str:
        from maidenflight.training import defaults

        usual = defaults.choose_randomization(self.task, self._control)
        return usual if self.randomize is None else self.randomize

    @property
    def _method(self) -> str:
        from maidenflight.training import defaults

        return self.method or defaults.choose_method(self.spec, self.start is not None)

    @property
    def _yaw_penalty(self) -> float:
        from maidenflight.training import defaults

        usual = defaults.choose_yaw_penalty(self._control, self._method)
        return usual if self.yaw_penalty is None else self.yaw_penalty

    @cached_property
    def controller(self) -> "Controller":
        """Returns the control structure."""
        from maidenflight.training import defaults

        file, start = self.drone_file, self.start and self.start.policy
        how = file.full_scale_counts, start, self._has_paper_scales, self.rate
        return defaults.choose_controller(self._control, file.parameters, *how)

    @property
    def _has_paper_scales(self) -> bool:
        """Returns whether actions are scaled as the paper does, as other formats and forms need."""
        return self.paper_scales or self.target == "authors" or self.form != "instants"

    def compute(self, output: Path, progress: Progress) -> Result:
        """Trains; writes a JSON a policy, `training.csv` with their scores, and a checkpoint."""
        from maidenflight.experiments import drones
        from maidenflight.identification.identity import identity_of
        from maidenflight.simulator.tasks.tasks import find_task
        from maidenflight.training import checkpoint, defaults, final_flights, folder, loggers
        from maidenflight.training.scores import Scores, describe_spread, describe_survival
        from maidenflight.training.settings import recorded
        from maidenflight.verbs.parts.training_watch import TrainingWatch

        saved, spec = output / run_folder.CHECKPOINT, self.spec
        if self.resume and not saved.exists():
            raise InputError(f"{saved}: no training to resume. {folder.how_to_start(output)}")
        learner: Any = self.learner_settings
        first, name = learner.updates, Path(self.drone).name
        if self.updates is None and "updates" not in self.learner:
            first = defaults.choose_first_updates(self._control, self._method, first)
        if self.resume and self.updates is None and checkpoint.stages(saved) != (first,):
            first = max(checkpoint.stages(saved))
            learner = dataclasses.replace(learner, updates=first)
        scores = Scores(learner, self.resume)
        drone = shared.own_files(self.drone)
        record = self.make_record(
            [*drone, *shared.own_files(self.initial)],
            control=self._control,
            randomize=self._randomization,
            paper_scales=self._has_paper_scales,
            yaw_penalty=self._yaw_penalty,
            method=type(learner).__name__,
            **(spec.to_dict() | {"look_ahead": spec.look_ahead.points}),
            look_ahead_spacing=spec.look_ahead.spacing,
            **recorded(learner),
        )
        for left in results.leftovers(output) if output.is_dir() else ():
            left.unlink(missing_ok=True)
        with loggers.opened(self.log, output, self.policies, record["settings"]) as show:
            watch = TrainingWatch(scores, show, progress)
            if self.controller.fitted is not None:
                progress.log(drones.describe_loop(self.drone_file))
            about = name, self.drone_file.parameters, self.drone_file.full_scale_counts
            how = find_task(self.task), self.controller, self.key
            policies, flights = final_flights.train_until_sound(
                partial(self._train, learner, saved, watch),
                partial(final_flights.fly_about, *about, *how),
                first,
                learner.updates,
            )
        if earlier := checkpoint.stages(saved)[:-1]:
            record["settings"]["extended_from"] = list(earlier)
        record["settings"]["updates"] = max(scores.updates)
        record["cores"], record["drone"] = compiler.count_devices(), identity_of(self.drone_file)
        record |= {"doubts": doubts} if (doubts := drones.doubts(self.drone_file)) else {}
        if falls := final_flights.find_falls(flights, name):
            record["settings"]["falls"] = falls
        drone_parameters = self.drone_file.parameters
        written = folder.write_policies(output, policies, record, drone_parameters, scores, falls)
        return Result(
            content={
                "policies": [str(path) for path in written["policies"]],
                "scores": scores.best,
                "flies": [not any(flight.is_fault for flight in own) for own in flights],
                "flights": [[flight._asdict() for flight in own] for own in flights],
            },
            summary=[
                Table("Trained policies", scores.columns, scores.rows),
                *describe_spread(scores.best),
                describe_survival(self._randomization, name),
                *final_flights.describe_flights(flights, name),
            ],
            notes=drones.describe_unknown(self.drone_file),
            written=written,
            read={"drone": drone},
            record=record,
            rows=scores.rows,
            next=("transfer", output, "--drone", self.drone),
            value=policies,
        )

    def _train(
        self,
        learner: Any,
        saved: Path,
        watch: "TrainingWatch",
        updates: int,
        members: Sequence[int] | None,
    ) -> "tuple[Policy, ...]":
        """Trains over the drones that the settings say, or trains on some of the policies."""
        from jax.random import split as split_key

        from maidenflight.deployment.check import check_export
        from maidenflight.experiments import drones
        from maidenflight.simulator.tasks.tasks import find_task
        from maidenflight.training import checkpoint, defaults
        from maidenflight.training.train import train

        watch.begin(updates)
        file, controller, fell = self.drone_file, self.controller, members is not None
        if self.target is not None:
            check_export(self.target, controller.interface, self.spec, file.parameters)
        return train(
            defaults.choose_task(find_task(self.task), self._control, self._yaw_penalty, fell=fell),
            controller,
            drones.distribution_of(file, self._randomization, controller),
            split_key(self.key, self.policies),
            dataclasses.replace(learner, updates=updates),
            policy=self.spec if self.start is None else self.start.policy,
            on_progress=watch.on_progress,
            on_update=watch.on_update,
            checkpoint=checkpoint.Checkpoint(saved, not self.resume and not fell, members),
        )

    def discard_state(self, output: Path) -> None:
        """Removes the checkpoint, which is larger than the policies."""
        (output / run_folder.CHECKPOINT).unlink(missing_ok=True)
