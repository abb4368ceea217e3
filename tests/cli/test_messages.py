"""What people read: notes, hints and summaries, none of which needs anything compiled."""

import dataclasses
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import click
import jax
import jax.numpy as jnp
import numpy as np
import polars
import pytest

from commands import Command
from maidenflight import cli, parameters, policy, policy_file
from maidenflight.errors import InputError
from maidenflight.experiments import comparison, drones
from maidenflight.experiments.policies import read_policies
from maidenflight.flights.checkup.result import LogWarning
from maidenflight.flights.reading import Flights
from maidenflight.identification.drone_file import DroneFile, Estimate, GroupGain
from maidenflight.identification.uncertainty import Evidence
from maidenflight.integrations.exporters.authors_json import to_authors_json
from maidenflight.names import CONTROLS, TASKS, WIDE
from maidenflight.registry import VERBS
from maidenflight.settings import Setting
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.terminal import Table, show
from maidenflight.training import checkpoint, defaults, scores
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.evaluation import Evaluation
from maidenflight.training.settings import Settings
from maidenflight.training.train import Progress
from maidenflight.verbs.parts import estimates_output, logs_output
from maidenflight.verbs.train import Train

TRAINING_PAGE = Path(__file__).parents[2] / "docs" / "training.md"


@pytest.fixture
def trained(tmp_path: Path) -> Path:
    """Policies of ours: two for the circle, one for hovering with the name of one of these, and one
    that does not say."""
    for place, task in (
        ("circle/policy_1", "circle"),
        ("circle/policy_2", "circle"),
        ("hover/policy_1", "hover"),
        ("any/policy_4", "tracking"),
        ("mute/policy_3", None),
    ):
        made = {"settings": {"task": task}} if task else {}
        policy_file.write_policy(
            tmp_path / f"{place}.json",
            policy.untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(3,))),
            made,
        )
    return tmp_path


@pytest.mark.parametrize("name", VERBS.own)
def test_a_summary_is_one_short_sentence_that_fits_the_list_of_commands(name: str) -> None:
    found = cli.commands.get_command(click.Context(cli.commands), name)
    assert found is not None
    summary = found.get_short_help_str(limit=66)
    assert summary.endswith(".")
    assert "..." not in summary


def test_the_list_of_commands_is_shown_where_none_is_given(command: Command) -> None:
    code, _, err = command()
    assert code == 2
    assert "Commands:" in err


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ("train --drone {tmp}/no.toml", "maidenflight identify LOGS -o {tmp}/no.toml"),
        (
            "predict {tmp}/circle --drone {tmp}/no.toml",
            "maidenflight identify LOGS -o {tmp}/no.toml",
        ),
        ("validate {tmp} drone.toml", "as in: maidenflight validate drone.toml {tmp}."),
        ("validate {tmp}/no.toml {tmp}", "maidenflight identify LOGS"),
        ("identify {tmp} --over thrust -o {tmp}/d.toml", "Did you mean thrust_to_weight"),
        ("identify {tmp} --over latncy -o {tmp}/d.toml", "Did you mean latency?"),
        ("identify {tmp} --bounds qqq=0,1 -o {tmp}/d.toml", "'qqq'. All are in"),
        (
            "transfer {tmp}/circle --reality virtal:3 -o {tmp}/t",
            "Did you mean virtual:3? Expected near:SEED",
        ),
        ("transfer {tmp}/circle --reality virtual -o {tmp}/t", "such as virtual:7"),
        ("transfer {tmp}/circle --reality crazyfly -o {tmp}/t", "Did you mean crazyflie?"),
        (
            "export {tmp}/circle -o {tmp}/c",
            "Give one file of it, such as {tmp}/circle/policy_1.json",
        ),
        ("export {tmp}/no.json -o {tmp}/c", "no such file. Give a policy file, such as"),
        (
            "export {tmp}/circle/policy_1.json --control attitude -o {tmp}/c",
            "a pwm policy, as its file says, not attitude",
        ),
        (
            "predict {tmp}/circle --drone crazyflie --control attitude -o {tmp}/p",
            "not attitude. Leave out --control",
        ),
        ("transfer {tmp}/circle --reference {tmp}/no.csv", "no.csv: not a readable CSV file"),
        ("envelope {tmp}/circle --reference a.csv --along speed", "a reference ends before"),
        ("predict {tmp}/circle --drone crazyflie --reference a.txt", "name ends with .csv"),
        ("train --updates x", "Options: maidenflight train --help."),
        ("soar", "No such command 'soar'. Options: maidenflight --help."),
    ],
)
def test_a_mistake_says_what_may_be_meant(
    arguments: str, says: str, trained: Path, monkeypatch: Any, command: Command
) -> None:
    monkeypatch.chdir(trained)
    code, out, err = command(arguments.format(tmp=trained))
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert err.startswith("maidenflight: ")
    assert says.format(tmp=trained) in err


def test_what_is_no_policy_is_told_without_the_words_of_a_parser(tmp_path: Path) -> None:
    path = tmp_path / "drone.toml"
    path.write_text("mass = 1")
    with pytest.raises(InputError, match=r"not valid JSON\. Give a policy file"):
        policy_file.read_policy(path)


def test_policies_fly_what_they_were_trained_for(trained: Path) -> None:
    def task_of(*folders: str, asked: str | None = None) -> tuple[str, list[str]]:
        return read_policies([trained / name for name in folders]).choose_task(asked)

    assert task_of("circle") == ("circle", [])
    assert task_of("hover") == ("hover", [])
    assert task_of("mute") == ("paper_circle", [])
    assert task_of("mute", "hover") == ("hover", [])
    assert task_of("any") == task_of("any", "circle") == ("circle", [])
    assert task_of("any", asked="mine.csv") == ("mine.csv", [])
    # Of an authors' policy whose name does not say what it commands.
    theirs = trained / "model.json"
    theirs.write_text(to_authors_json(policy.untrained_policy(jax.random.key(0))))
    assert read_policies([theirs], "pwm").choose_task("circle") == ("circle", [])
    with pytest.raises(InputError, match="do not say what they command"):
        read_policies([theirs])
    for folders, asked, task, note in (
        (("hover",), "circle", "circle", "policy_1 flies circle, trained for hover"),
        (("circle", "hover"), None, "circle", "hover/policy_1 flies circle, trained for hover"),
        (("circle",), "hover", "hover", "policy_2 flies hover, trained for circle"),
    ):
        flown, (said,) = task_of(*folders, asked=asked)
        assert flown == task
        assert said.endswith(f"{note}.")
    folders = [trained / name for name in ("circle", "hover", "any", "mute")]
    own = read_policies(folders).choose_tasks(None)
    assert own == (["circle", "circle", "hover", "circle", "paper_circle"], [])


def test_the_best_policy_is_told_from_one_of_the_same_name(trained: Path) -> None:
    policies = read_policies([trained / "circle", trained / "hover", trained / "hover"])
    assert policies.own_names == ["circle/policy_1", "circle/policy_2", "hover/policy_1"]
    rows = [
        ("circle/policy_1", 3.0, 0.1, 0.01),
        ("circle/policy_2", 20.0, 0.05, 0.4),
        ("hover/policy_1", 20.0, 0.1, 0.02),
    ]
    table = polars.DataFrame(
        [
            {
                "policy": name,
                "reality": "virtual:7",
                "duration": duration,
                **{"position_error": 0.5, "estimated_error": error},
                "command_change": change,
                "at_limits": 0.0,
                "end_reason": reason,
                **{"largest_tilt": np.radians(25.0 * duration / 20.0), "largest_distance": 0.1},
                "largest_body_rate": 1.0,
            }
            for name, duration, error, change in rows
            for reason in ("tilt", "time limit")
        ]
    )
    best = comparison.choose_best(table, policies.own_names)
    assert policies.path_of(best) == policies.paths[2]
    summary = comparison.summarize(table)
    assert summary.columns == [
        "policy",
        "reality",
        "flights",
        "time_limit",
        "duration",
        "position_error",
        "estimated_error",
        "command_change",
        "at_limits",
        *comparison.LARGEST,
    ]
    assert summary.row(1)[:8] == ("circle/policy_2", "virtual:7", 2, 1, 20.0, 0.5, 0.05, 0.4)
    (near,) = comparison.describe_margins(summary)
    assert near.startswith("circle/policy_2, hover/policy_1: tilts of up to 25 deg")
    (note,) = comparison.describe_limit_cycles(summary)
    assert note.startswith("circle/policy_2 in virtual:7 changes its commands by 0.40 ")


def test_equal_notes_are_said_once() -> None:
    def said(*notes: str) -> list[str]:
        return logs_output.describe_flights(Flights((), notes, ()))[1:]

    assert said(
        *("a.csv: battery assumed", "b.csv: battery empty", "c.csv: battery assumed"),
        "10 of 20 s used",
    ) == ["  2 files: battery assumed", "  b.csv: battery empty", "  10 of 20 s used"]
    many = said(*(f"a.csv: {number} rows dropped" for number in range(12)))
    assert len(many) == 11
    assert many[-1] == "  and 2 more; --json lists them all"


def test_gains_are_a_table_with_a_note_where_an_error_is_unknown() -> None:
    known, unknown = GroupGain("drag", 0.1, 0.02, True), GroupGain("lag", 0.0018, None, True)
    shown: list[Any] = [
        estimates_output.tabulate_gains(cast(Any, SimpleNamespace(gains=gains)))
        for gains in ((known,), (known, unknown))
    ]
    drag, lag = ["drag", "+0.1000", "0.0200", "kept"], ["lag", "+0.0018", "unknown", "kept"]
    assert [table.cells for table, *_ in shown] == [[drag], [drag, lag]]
    assert [len(notes) for _, *notes in shown] == [0, 1]


def test_a_score_is_a_line_with_the_speed_since_the_first(monkeypatch: Any) -> None:
    clock = iter((0.0, 1.0, 1.0, 3.0))
    clocks = SimpleNamespace(perf_counter=lambda: next(clock))
    monkeypatch.setattr(scores, "time", clocks)
    score = Evaluation(*(jnp.array([value, value]) for value in (-7.5, 1.0, 0.013, 5.0)))
    best: Any = ()
    heard = scores.Scores(AnalyticGradient(updates=100), resumed=False)
    line = "return -7.5, survival 100%, error 1.3 cm"
    assert heard.add(Progress(10, 1000, score, best)) == line
    assert heard.add(Progress(20, 11000, score, best)) == f"{line}, 5 k steps/s"


def test_seeds_that_differ_much_are_said_to() -> None:
    def best(*errors: float) -> list[dict[str, float]]:
        return [{"survival": 1.0, "position_error": error} for error in errors]

    assert scores.describe_spread(best(0.01)) == []
    spread = "spread over 2 seeds: survival 100% to 100%, position error 1.0 to"
    assert scores.describe_spread(best(0.01, 0.014)) == [f"{spread} 1.4 cm."]
    (much,) = scores.describe_spread(best(0.01, 0.02))
    assert much.startswith(f"{spread} 2.0 cm: they differ much")


def test_what_survival_refers_to_is_said() -> None:
    for over, words in (("any-day", "with trims, payloads"), (0.1, "within 10% of"), (0.0, "all")):
        assert f"{words}" in (line := scores.describe_survival(over, "drone.toml"))
        assert "drone.toml" in line


def test_what_is_unknown_of_a_drone_is_said_where_policies_are_trained_for_it() -> None:
    drone = parameters.crazyflie()
    assert drones.describe_unknown(DroneFile(drone, name="crazyflie")) == []
    (none,) = drones.describe_unknown(DroneFile(drone, name="mine.toml"))
    assert none.startswith("mine.toml: no parameter was identified")
    known: Any = {"thrust_to_weight": None}
    lag = DroneFile(drone, known, unidentified={"latency": (0.0, 0.012)}, name="mine.toml")
    (some,) = drones.describe_unknown(lag)
    assert "do not determine latency (0 to 0.012), SI units" in some
    assert drones.describe_unknown(DroneFile(drone, known, name="mine.toml")) == []


def test_a_drone_s_warnings_are_a_line_each_and_ten_at_most() -> None:
    drone, known = parameters.crazyflie(), {"thrust_to_weight": None}
    one = LogWarning("flight", "a.csv", "No flight.", "Leave it out.", 0.0, "0.15 % or more", True)
    alike = (one, dataclasses.replace(one, file="b.csv"))
    file = DroneFile(drone, cast(Any, known), name="runs/mine.toml", warnings=alike)
    (line,) = drones.describe_unknown(file)
    assert line == "mine.toml: a.csv: No flight. Leave it out. (And 1 more log.)"
    many = tuple(LogWarning("identification", "", f"Doubt {number}.") for number in range(14))
    assert len(drones.doubts(dataclasses.replace(file, warnings=many))) == 10
    (sure, others) = drones.repeat_doubts(dataclasses.replace(file, warnings=(one, *many)))
    assert sure == "mine.toml: a.csv: No flight. Leave it out."
    assert "14 doubts" in others
    assert len(drones.repeat_doubts(dataclasses.replace(file, warnings=many[:1]))) == 1


def help_of(name: str) -> Setting:
    """What the command line says of a setting of training."""
    return Train.settings()[name][1]


def usual_settings(
    structure: str,
    task: str = "circle",
    method: str = "gradient",
    memory: int = 0,
    initial: bool = False,
) -> Settings:
    spec = PolicySpec(memory=memory)
    return defaults.choose_settings(structure, task, method, spec, initial)


def test_the_page_that_the_help_of_training_names_tells_how_many_updates_are_usual() -> None:
    assert help_of("updates").usual == f"see docs/{TRAINING_PAGE.name}"
    told = " ".join(TRAINING_PAGE.read_text().split())
    usual = {structure: usual_settings(structure).updates for structure in CONTROLS}
    remembering = usual_settings("attitude", memory=16).updates
    first = defaults.choose_first_updates("attitude_rate", "gradient", usual["attitude_rate"])
    assert f"| pwm | {usual['pwm']} |" in told
    assert f"| attitude_rate | {first}; {usual['attitude_rate']} if it falls then |" in told
    assert f"| attitude | {usual['attitude']}; {remembering} with a memory |" in told
    assert usual["attitude_rate"] == usual["pwm"]
    long = ("figure_eight", "fast_figure_eight", "tracking")
    for structure, count in usual.items():
        for task, times, word in (
            ("hover", 2, "| hover | twice that |"),
            *(
                (name, 3, f"| {', '.join(long)}; distillation | three times that |")
                for name in long
            ),
        ):
            assert usual_settings(structure, task).updates == times * count
            assert word in told
        by_gradient, distilled = (
            usual_settings(structure, method=method, memory=16).updates
            for method in ("gradient", "distillation")
        )
        assert distilled == 3 * by_gradient
    ppo = usual_settings("pwm", method="ppo").updates
    further = usual_settings("pwm", initial=True).updates
    assert f"| PPO; `--from` | {ppo} epochs; {further} |" in told


def test_the_help_of_training_tells_the_usual_randomization() -> None:
    usual = {
        structure: {task: defaults.choose_randomization(task, structure) for task in TASKS}
        for structure in CONTROLS
    }
    narrow = [task for task, box in usual["pwm"].items() if box != WIDE]
    slow = {structure: boxes["circle"] for structure, boxes in usual.items()}
    assert help_of("randomize").usual == (
        f"{slow['pwm']}; {slow['attitude_rate']} for attitude_rate; 0.1 for fast tasks"
    )
    assert narrow == [task for task in TASKS if task.startswith("fast_")]
    assert slow["attitude"] == slow["pwm"] == WIDE
    assert all(boxes[task] == 0.1 for boxes in usual.values() for task in narrow)


def test_the_help_of_training_tells_the_usual_hidden_layers() -> None:
    usual = {
        (structure, method): ",".join(map(str, defaults.choose_hidden(structure, method)))
        for structure in CONTROLS
        for method in ("gradient", "ppo")
    }
    larger = usual.pop(("attitude_rate", "gradient"))
    assert set(usual.values()) == {"50,50"}
    assert help_of("hidden").usual == f"50,50; {larger} for attitude_rate"
    distilled = {
        ",".join(map(str, defaults.choose_hidden(structure, "distillation")))
        for structure in CONTROLS
    }
    told = " ".join(TRAINING_PAGE.read_text().split())
    assert f"{larger} for attitude_rate by gradients, {distilled.pop()} by distillation" in told
    assert distilled == set()


def test_a_checkpoint_of_other_settings_says_which(tmp_path: Path) -> None:
    path, state = tmp_path / "training.npz", np.zeros(2, np.float32)
    words = {"settings": {"horizon": 32, "num_envs": 4}, "history": 2}
    checkpoint.save(path, state, checkpoint.fingerprint(words, state), (9,))
    for others, numbers, says in (
        (
            {**words, "settings": {"horizon": 64, "num_envs": 4}},
            state,
            r"another training: horizon was 32 and is 64\. Give",
        ),
        ({**words, "history": 3}, state, r"another training: history was 2 and is 3\. Give"),
        (
            words,
            state + 1,
            r"another training: it had another seed, drone, or randomization\. Give",
        ),
    ):
        with pytest.raises(InputError, match=says):
            checkpoint.restored(path, lambda _: state, checkpoint.fingerprint(others, numbers))
    np.testing.assert_array_equal(
        checkpoint.restored(path, lambda _: state, checkpoint.fingerprint(words, state))[0], state
    )


def test_ctrl_c_before_the_first_score_says_that_nothing_was_reached(
    tmp_path: Path, monkeypatch: Any, command: Command
) -> None:
    def interrupted(*_arguments: Any, **_options: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Train, "compute", interrupted)
    what = ["train", "--drone", "crazyflie", "-o", str(tmp_path / "made"), "--overwrite"]
    code, out, err = command(*what)
    assert (code, out) == (130, "")
    assert (
        err.strip() == "maidenflight: interrupted before anything was reached. Start again with: "
        f"maidenflight {' '.join(what)}"
    )


def test_estimates_have_units_to_read_and_say_what_they_rest_on(capsys: Any) -> None:
    estimates = {
        "latency": Estimate(0.00715, (0.00708, 0.00721), (0.007, 0.0072), 0.00022, None),
        "torque_bias_x": Estimate(-5.883e-05, (-9.705e-05, -2.316e-05), (-5.8e-05,), 1.1e-4, None),
    }
    noise = {"position_walk": 0.0924, "velocity_noise": 0.0, "actuator_noise": 0.02}
    fit = {"value": -14.82, "start_value": -13.42, "evaluations": 8, "seconds": 107.2}
    found: Any = SimpleNamespace(
        estimates=estimates,
        noise=noise,
        parameters=parameters.crazyflie(),
        objective="likelihood",
        unidentified={"inertia_x": (9.3e-6, 2e-5), "drag_x": (0.0, 0.5)},
        source=SimpleNamespace(flights=4, seconds=120.0),
        advice=(),
        evidence=(Evidence("gyro x", 0.08, (0.07, 0.09)),),
        **fit,
    )
    show(
        *estimates_output.tabulate_estimates(found),
        *estimates_output.summarize(found),
        *estimates_output.tabulate_evidence(found),
        *estimates_output.describe_fit(found, "crazyflie"),
    )
    out = capsys.readouterr().out
    assert re.search(r"latency +7\.15 +7\.08 \.\. 7\.21 +0\.22 +ms", out)
    assert re.search(r"torque_bias_x +-58\.83 +-97\.05 \.\. -23\.16 +110 +1e-6 N m", out)
    assert re.search(r"inertia_x +start's 13\.3 +9\.3 \.\. 20 \(plausible\) +1e-6 kg m2", out)
    assert "identified: latency 7.15 [7.08, 7.21] ms and 1 more, from 4 flights, 120 s\n" in out
    assert "\nnot identified: inertia_x, drag_x, no more than before these flights" in out
    assert re.search(r"motor lag and latency +gyro x +80 +5\.1 +ms", out)
    assert "taken from crazyflie: mass 28 g and rotors 39.6 mm from the centre" in out
    assert "noise: position_walk 0.0924 m/sqrt(s), actuator_noise 0.02\n" in out
    assert (
        "log-likelihood 14.82 nats a row (13.42 for crazyflie; more is better), after 8 "
        "evaluations of it in 107.2 s" in out
    )
    found.objective = "replay"
    truth = {"latency": "7 + 3 sensors", "torque_bias_x": -6e-05}
    found.unidentified = {}
    show(*estimates_output.tabulate_estimates(found, truth), *estimates_output.summarize(found))
    out = capsys.readouterr().out
    assert "between trials: standard deviation" in out
    assert "\nnot identified: nothing" in out
    assert re.search(r"torque_bias_x .* -60 +1e-6 N m", out)


def test_nothing_foreign_controls_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    name = "\x1b[31mred\x07 \u202eevil [bold]x[/bold] \udcff"
    shown = r"\u001b[31mred\u0007 \u202eevil [bold]x[/bold] \udcff"
    show(name, Table("title", {"name": "{name}"}, [{"name": name}]))
    assert capsys.readouterr().out.count(shown) == 2
    assert str(InputError(name)) == shown
