"""Every snippet in the README and the docs runs: the real functions, with less work each."""

import ast
import dataclasses
import importlib.util
import json
import pkgutil
import re
import shlex
import sys
from collections import Counter
from collections.abc import Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import click
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from click.testing import CliRunner
from jaxtyping import Array

import maidenflight as mf
from maidenflight import (
    cli,
    parameters,
    policy,
    policy_file,
)
from maidenflight import simulator as sim
from maidenflight.errors import InputError
from maidenflight.flights import flight_csv, log
from maidenflight.flights.log import Flight
from maidenflight.flights.trims import rotors
from maidenflight.identification.drone_file import DroneFile
from maidenflight.identification.likelihood.estimator import Question, answer_question
from maidenflight.identification.outcome.problem import Problem
from maidenflight.parameters import noiseless
from maidenflight.policy import Policy
from maidenflight.registry import DRONE_FORMATS, EXPORTERS, REALITIES, VERBS
from maidenflight.simulator import environment
from maidenflight.simulator.controllers import control
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.realities.virtual_drone import VirtualDrone
from maidenflight.studies import study
from maidenflight.verb import Verb, find_verb
from pages import ROOT, blocks, run_python, run_snippet, section
from quick import QUICK, make_identification_quick, make_training_quick, traced_training

GUIDES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
PAGES = [*GUIDES, ROOT / "CONTRIBUTING.md", *sorted((ROOT / "paper" / "notes").glob("*.md"))]
LESS_WORK = {
    "record": ["--flights", "2", "--duration", "4"],
    "identify": ["--trials", "1", "--evaluations", "15", "--over", "thrust_to_weight,latency"],
    "train": ["--updates", "2"],
    "transfer": ["--trials", "1", "--duration", "0.5", "--against", "pid"],
    "predict": ["--trials", "2", "--duration", "0.5", "--against", "pid"],
}


def run_commands(snippets: list[str], monkeypatch: pytest.MonkeyPatch) -> int:
    """Runs what calls maidenflight in shell snippets, with less work, and counts it."""
    make_identification_quick(monkeypatch)
    lines = [shlex.split(line, comments=True) for line in "".join(snippets).splitlines()]
    commands = [words for words in lines if words[:1] == ["maidenflight"]]
    for words in commands:
        monkeypatch.setattr(sys, "argv", words + LESS_WORK.get(words[1], []))
        cli.main()
    return len(commands)


@cache
def recorded_flights() -> Sequence[Flight]:
    """Logs of which all pages are."""
    return mf.record(mf.virtual_drone(7), jax.random.key(0), flights=2, duration=4.0)


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An empty folder to work in, and little training."""
    monkeypatch.chdir(tmp_path)
    make_training_quick(monkeypatch)


@pytest.mark.slow
def test_the_python_of_the_simulators_page_runs() -> None:
    pytest.importorskip("gymnasium")
    snippets = blocks("docs/simulator.md", "python")
    assert len(snippets) >= 6
    names: dict[str, Any] = {}
    for snippet in snippets:
        if "bullet" in snippet and importlib.util.find_spec("pybullet") is None:
            continue
        run_snippet(snippet, "docs/simulator.md", names)
    assert names["picture"].shape == (480, 640, 3)


@pytest.mark.slow
def test_the_commands_of_the_readme_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number, flight in enumerate(recorded_flights()):
        flight_csv.write(f"flights/flight_{number}.csv", flight)
    assert run_commands(blocks("README.md", "sh"), monkeypatch) >= 5
    assert (tmp_path / "report.html").exists()
    assert (tmp_path / "firmware/policy.c").exists()


def test_the_make_targets_that_the_pages_name_exist() -> None:
    makefile = (ROOT / "Makefile").read_text()
    named = {
        name
        for page in ("README.md", "CONTRIBUTING.md")
        for name in re.findall(r"\bmake (\w+)", (ROOT / page).read_text())
    }
    assert {"demo", "test"} <= named
    assert all(f"\n{name}:" in makefile for name in named)


def test_the_log_format_page_lists_every_column_of_the_format() -> None:
    page = (ROOT / "docs/flight-log.md").read_text()
    rows = " ".join(line for line in page.splitlines() if line.startswith("| `"))
    for columns in log.GROUPS.values():
        for column in columns:
            assert f"`{column}`" in rows or column in ("command_2", "command_3"), column


def test_the_questions_list_every_named_drone() -> None:
    page = section("docs/questions.md", "How do I describe my drone?")
    (names,) = re.findall(r"They are (.*?), which is guessed", " ".join(page.split()))
    assert re.findall(r"`(.*?)`", names) == list(parameters.DRONES)


def test_pages_link_only_to_what_exists_and_name_only_files_that_exist() -> None:
    for page in PAGES:
        text = page.read_text()
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", text):
            assert (page.parent / target).exists(), (page.name, target)
        named = re.findall(
            r"(?<![\w./-])(?:paper|benchmarks|examples|tests|docs|src/maidenflight)/[\w./-]+\.\w+",
            text,
        )
        assert [file for file in named if not (ROOT / file).exists()] == [], page.name


def test_all_public_names_resolve() -> None:
    missing: list[Any] = [name for name in mf.__all__ if not hasattr(mf, name)]
    assert missing == []
    apart = ("__version__", "simulator")
    assert all(callable(getattr(mf, name)) for name in mf.__all__ if name not in apart)
    assert len(mf.__all__) <= 36
    assert all(callable(getattr(sim, name)) for name in sim.__all__)
    with pytest.raises(AttributeError):
        _ = mf.nonsense  # type: ignore[attr-defined]
    assert np.isfinite(float(parameters.crazyflie().mass))


@pytest.mark.slow
def test_the_python_of_the_training_page_runs(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(mf, "AnalyticGradient", lambda updates: QUICK, raising=False)
    names = run_python("docs/training.md")  # by the program of the demo
    assert [policy.layer_sizes for policy in names["policies"]] == [(40, 50, 50, 4)] * 3
    assert Path("training.npz").exists()


@pytest.mark.slow
def test_the_python_on_predicted_flights_runs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in (1, 2):
        path = f"policies/policy_{number}.json"
        policy_file.write_policy(path, policy.untrained_policy(jax.random.key(number)))
    parameters.write_drone("drone.toml", parameters.crazyflie(), {})
    monkeypatch.setattr(
        mf,
        "predict_flight_times",
        partial(mf.predict_flight_times, trials=2, duration=0.5),
        raising=False,
    )
    names = run_python("docs/evaluation.md", "Predict")
    assert names["flights"]["policy"].to_list() == ["policy_1"] * 2 + ["policy_2"] * 2
    assert "quantile_90" in names["summary"](names["flights"]).columns
    assert "policy_2" in capsys.readouterr().out


@pytest.mark.night
def test_the_commands_on_the_envelope_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("maidenflight.simulator.tasks.trajectories.RAMP_DURATION_S", 1.0)
    monkeypatch.setattr("maidenflight.experiments.envelope.DURATION_S", 0.1)
    policy_file.write_policy(
        tmp_path / "policies" / "policy_1.json", policy.untrained_policy(jax.random.key(0))
    )
    commands = "".join(blocks("docs/evaluation.md", "sh", "Envelope"))
    for number, line in enumerate(commands.splitlines()):
        words = shlex.split(line, comments=True)[1:]
        cli.commands([*words, "--flights", "2", "-o", str(number)], standalone_mode=False)
        assert Path(str(number), "envelope.svg").exists()


@pytest.mark.parametrize(
    "papers",
    [pytest.param(False, marks=pytest.mark.slow), pytest.param(True, marks=pytest.mark.night)],
)
def test_the_python_of_the_identification_page_runs(
    papers: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without its last line, the paper's objective, or with it, which takes as long as the rest."""
    for number, flight in enumerate(recorded_flights()):
        flight_csv.write(f"run/recorded/flight_{number}.csv", flight)
    monkeypatch.setattr(
        mf,
        "identify",
        partial(quick_identification, mf.identify),
        raising=False,
    )
    few = {"settings": mf.Likelihood(physics_step=0.005), "over": ("thrust_to_weight", "latency")}
    monkeypatch.setattr(
        mf, "expected_intervals", partial(mf.expected_intervals, **few), raising=False
    )
    (snippet,) = blocks("docs/identification.md", "python")
    first, _, last = snippet.strip().rpartition("\n")
    assert "mf.Replay()" in last
    names = run_snippet(snippet if papers else first, "docs/identification.md")
    assert "thrust_to_weight" in capsys.readouterr().out
    assert len(names["drones"].drones.mass) > 100
    assert not papers or names["paper"].objective == "replay"


@pytest.mark.slow
def test_the_python_on_realities_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    policies = [policy.untrained_policy(jax.random.key(0))]
    monkeypatch.setattr(mf, "transfer", partial(mf.transfer, duration=0.5), raising=False)
    names = run_python("docs/evaluation.md", "Your own", policies=policies)
    assert set(names["evaluation"].table["reality"]) == {"virtual:7", "worn-7"}


@pytest.mark.parametrize(
    ("words", "count"),
    [
        pytest.param("--reference", 1, marks=pytest.mark.slow),
        pytest.param("maidenflight", 4, marks=pytest.mark.night),
    ],
)
def test_the_commands_on_realities_run(
    words: str, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each kind of drone and task is a program: that of a reference, or all."""
    pytest.importorskip("pybullet")
    policy_file.write_policy("policies/policy_1.json", policy.untrained_policy(jax.random.key(0)))
    DroneFile(mf.crazyflie()).write("drone.toml")
    Path("mine.csv").write_text("t,x,y,z\n0,0,0,1\n1,0.1,0,1\n")
    lines = "".join(blocks("docs/evaluation.md", "sh", "Transfer")).splitlines(keepends=True)
    assert run_commands([line for line in lines if words in line], monkeypatch) == count
    assert Path("mine/flights.csv").exists()
    assert Path("recorded/reality.toml").exists() == (count == 4)


@pytest.mark.slow
def test_a_reality_of_ones_own_as_the_page_on_extending_shows_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    used, entered = extensions("A reality")
    monkeypatch.setattr(mf, "transfer", partial(mf.transfer, duration=0.5), raising=False)
    monkeypatch.setitem(REALITIES.own, "mine", "")
    names: dict[str, Any] = {"policies": [policy.untrained_policy(jax.random.key(0))]}
    monkeypatch.syspath_prepend(ROOT / "examples")
    for snippet in (
        used.replace("flights=2, duration=4.0", "flights=1, duration=1.0"),
        entered,
    ):
        run_snippet(snippet, "docs/extending.md", names)
    (flight,) = names["flights"]
    assert np.abs(flight.attitude[:, :2]).max() < 0.4
    assert np.abs(flight.position[:, 2] - 1.0).max() < 0.2
    assert set(names["evaluation"].table["reality"]) == {"virtual:7", "mine"}
    assert mf.reality("mine:0").name == "mine"
    policy_file.write_policy("policies/policy_1.json", policy.untrained_policy(jax.random.key(0)))
    (command,) = [
        shlex.split(line)
        for line in blocks("docs/extending.md", "sh")[-1].splitlines()
        if "--reality" in line
    ]
    monkeypatch.setattr(sys, "argv", command + LESS_WORK["transfer"])
    monkeypatch.setattr("sys.path", list(sys.path))
    cli.main()
    assert "mine" in Path("transfer/flights.csv").read_text()


def must_parse(name: str, words: list[str]) -> None:
    """Fails unless there is such a command with such options."""
    command = cli.commands.get_command(click.Context(cli.commands), name)
    assert command is not None, name
    command.parse_args(click.Context(command, info_name=name), words)


def test_every_command_that_a_page_shows_is_one_that_there_is() -> None:
    shown = 0
    for page in [str(path.relative_to(ROOT)) for path in PAGES]:
        for line in [
            line for block in blocks(page, "sh") for line in block.replace("\\\n", " ").splitlines()
        ]:
            words = shlex.split(line, comments=True)
            if words[:1] != ["maidenflight"]:
                continue
            must_parse(words[1], words[2:])
            shown += 1
    assert shown > 20


def quick_identification(identify: Any, flights: Any, settings: Any = None, **named: Any) -> Any:
    """`identify` of two parameters in one trial."""
    given = settings or mf.Likelihood()
    less = dataclasses.replace(given, evaluations=15, trials=1)
    if isinstance(less, mf.Likelihood):
        less = dataclasses.replace(less, physics_step=0.005)
    return identify(flights, less, **{**named, "over": ["thrust_to_weight", "latency"]})


@pytest.fixture
def less_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same verbs with less work each, of shapes that other tests of this file have compiled."""

    def with_less(name: str, **less: Any) -> None:
        verb = getattr(mf, name)
        monkeypatch.setattr(
            mf, name, lambda *given, **named: verb(*given, **{**named, **less}), raising=False
        )

    with_less("record", flights=2, duration=4.0)
    monkeypatch.setattr(mf, "identify", partial(quick_identification, mf.identify), raising=False)
    with_less("train", settings=QUICK)
    with_less("transfer", trials=3, duration=0.5)


def traced_flights(policies: list[Policy], realities: list[VirtualDrone], **given: Any) -> None:
    """In the place of flights: their first half second is traced, not compiled."""
    task, controller = (
        given.get("task", sim.circle()),
        given.get("controller", sim.pwm()),
    )
    for reality in realities:
        env = reality.environment(task, controller, spec=policies[0].spec)

        def fly(key: Array, drone: mf.Parameters, env: sim.Environment = env) -> Any:
            return sim.rollout(env, policies[0], sim.reset(env, drone, key), drone, key, steps=50)

        jax.eval_shape(fly, jax.random.key(0), reality.parameters)


@pytest.mark.slow
@pytest.mark.parametrize("word", ["describe", "logs", "task"])
@pytest.mark.usefixtures("less_work")
def test_the_python_of_a_question_is_short_and_runs(
    word: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = "docs/questions.md"
    titles = re.findall(r"^## (.*)$", (ROOT / page).read_text(), re.M)
    (title,) = [one for one in titles if word in one and blocks(page, "python", one)]
    (snippet,) = blocks(page, "python", title)
    assert len([line for line in snippet.splitlines() if line]) <= 15
    monkeypatch.setattr(mf, "train", traced_training)
    monkeypatch.setattr(mf, "transfer", traced_flights)
    if word == "logs":
        (flight,) = mf.record(mf.virtual_drone(7), jax.random.key(0), rate=100)[:1]
        time = flight.period * np.arange(len(flight))[:, None]
        angles = np.degrees(flight.attitude)
        table = np.hstack(
            [time, flight.position, flight.velocity, angles, flight.body_rates, flight.command]
        )
        np.savetxt(
            "my_log.csv",
            table,
            delimiter=",",
            comments="",
            header="time,x,y,z,vx,vy,vz,roll,pitch,yaw,p,q,r,m1,m2,m3,m4",
        )
    run_snippet(snippet, page)
    if word == "logs":
        assert Path("flight.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.slow
@pytest.mark.parametrize(("page", "title"), [("quickstart", "In Python"), ("concepts", None)])
@pytest.mark.usefixtures("less_work")
def test_the_python_of_the_first_pages_runs(
    page: str, title: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mf, "train", traced_training)
    for flight in recorded_flights() if page == "quickstart" else []:
        flight_csv.write(f"run/recorded/{flight.name}.csv", flight)
    run_python(f"docs/{page}.md", title)
    assert Path("firmware/policy.c").exists() == (page == "quickstart")
    assert Path("report.html").exists() == (page == "quickstart")


@pytest.mark.night
@pytest.mark.usefixtures("less_work")
def test_the_cells_of_the_notebook_run_and_it_stores_no_outputs() -> None:
    cells = json.loads((ROOT / "docs/notebooks/from_logs_to_policy.ipynb").read_text())["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code)
    names: dict[str, Any] = {}
    for cell in code:
        source = "".join(cell["source"])
        if not source.startswith("%"):
            run_snippet(source, "from_logs_to_policy.ipynb", names)
    assert len(names["evaluation"].table) == 9
    assert Path("firmware/policy.c").exists()


def test_the_papers_page_names_existing_functions_and_tests_and_every_cited_equation() -> None:
    text = (ROOT / "paper/notes/paper.md").read_text()
    folders = (ROOT / "tests", ROOT / "paper" / "tests")
    tests = {path.name: path.read_text() for one in folders for path in one.rglob("test_*.py")}
    named = re.findall(r"`(test_\w+\.py)::(test_\w+)`", text)
    assert len(named) > 30
    for file, test in named:
        assert f"def {test}(" in tests[file], (file, test)
    cited = {
        label
        for path in (ROOT / "src").rglob("*.py")
        for label in re.findall(r"\beq:[\w-]+", path.read_text())
    }
    rows = [line for line in text.splitlines() if line.startswith("| `eq:")]
    assert {row.split("`")[1] for row in rows} == cited
    assert all("](../../docs/api/" in row and "::test_" in row for row in rows)


def shown(page: Path) -> set[str]:
    """The modules whose contents a page of the API shows."""
    return set(re.findall(r"^::: (\S+)", page.read_text(), re.M))


def test_links_into_the_api_lead_to_what_its_page_shows() -> None:
    links = {
        link
        for page in PAGES
        for link in re.findall(r"(\w+)\.md#(maidenflight\.[\w.]+)", page.read_text())
    }
    assert len(links) > 40
    for page, name in sorted(links):
        assert any(
            name.startswith(f"{module}.") for module in shown(ROOT / f"docs/api/{page}.md")
        ), (page, name)
        assert pkgutil.resolve_name(name) is not None


def test_the_api_shows_every_module_and_its_index_every_public_name() -> None:
    source = ROOT / "src/maidenflight"
    modules = {
        path.stem
        for path in source.iterdir()
        if path.suffix == ".py" or (path / "__init__.py").exists()
    }
    public = {f"maidenflight.{name}" for name in modules if not name.startswith("_")} - {
        "maidenflight.cli"
    }
    pages = set().union(*(shown(page) for page in (ROOT / "docs/api").glob("*.md")))
    assert {".".join(name.split(".")[:2]) for name in pages} == public
    index = (ROOT / "docs/api/index.md").read_text()
    names = [*mf.__all__, *sim.__all__]
    assert all(f"[`{name}`]" in index for name in names if name != "__version__")


def extensions(title: str) -> list[str]:
    """The Python of a section of the page on extending."""
    return blocks("docs/extending.md", "python", title)


@pytest.mark.usefixtures("less_work")
@pytest.mark.slow
def test_a_control_structure_is_added_in_three_places(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mf, "train", traced_training)
    monkeypatch.setattr(mf, "transfer", traced_flights)
    monkeypatch.setattr(control, "DRIVES", dict(control.DRIVES))
    (snippet,) = extensions("A control structure")
    assert [line[:4] for line in snippet.splitlines() if re.match(r"# \d", line)] == [
        "# 1.",
        "# 2.",
        "# 3.",
    ]
    names = run_snippet(snippet, "docs/extending.md")
    read = policy_file.read_policy("policies/torques.json")
    assert read.interface == names["TORQUES"]
    assert control.controller_for(read.interface).interface == names["TORQUES"]
    assert '#define MF_CONTROL "torques"' in Path("firmware/policy.h").read_text()


@pytest.mark.usefixtures("less_work")
@pytest.mark.slow
def test_a_property_of_a_policy_s_input_is_one_class(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("onnx")
    monkeypatch.setattr(mf, "train", traced_training)
    monkeypatch.setattr(mf, "transfer", traced_flights)
    names = run_python("docs/extending.md", "A property of a policy's input")
    (one, _), spec = names["policies"], names["spec"]
    one.check()
    assert (one.spec, one.layer_sizes) == (spec, (41, 50, 50, 4))
    with pytest.raises(InputError, match="log_height = True, which the templates of the C"):
        mf.export(one, "firmware")
    with pytest.raises(InputError, match="log_height = True, but the authors' policies"):
        mf.export(one, "authors", "authors")
    with pytest.raises(InputError, match=r"\(41,\) values, expected 40"):
        policy_file.from_json(policy_file.to_json(one))
    # What it sees in flight is what training shows it.
    state = dynamics.at_hover(jnp.array([0.1, 0.2, 0.5]), noiseless(mf.crazyflie()))
    env = sim.Environment(spec=spec)
    begun = environment.begin(
        env, state, jnp.float32(0), noiseless(mf.crazyflie()), jax.random.key(0)
    )
    seen = environment.observation(env, begun)
    assert float(seen[-1]) == pytest.approx(np.log(0.5))
    act = policy.Actor(one, 0.5).act(begun.measurement, sim.circle().reference(jnp.float32(0)))
    assert np.isfinite(act.action).all()


@pytest.mark.slow
def test_an_observation_model_is_one_class_that_the_estimator_fits() -> None:
    """That of the page, of measured rotor speeds in whole rad/s."""
    names = run_python("docs/extending.md", "An observation model")
    truth, flights = mf.virtual_drone(7), []
    for flight in recorded_flights():
        after = 2300 * rotors(flight, truth.parameters).speed  # at the end of each row
        speeds = np.round(np.concatenate([after[:1], after[:-1]]))
        flights.append(dataclasses.replace(flight, rotor_speed=speeds))
    problem, model = Problem.of(flights), names["RotorSpeedErrors"].of(flights)
    lags = ("motor_time_constant", "spin_down_ratio", "motor_coasting", "latency")
    question = Question(model, lags, problem.start)
    posterior = answer_question(problem, mf.Likelihood(), question)
    assert set(posterior.samples) == set(lags)
    for name, error in {
        "motor_time_constant": 5e-4,
        "latency": 3e-4,
        "spin_down_ratio": 0.02,
    }.items():
        best, true = getattr(posterior.best.drone, name), getattr(truth.parameters, name)
        assert best == pytest.approx(true, abs=error), name


def trees(*words: str) -> dict[str, ast.Module]:
    """The syntax of the source files that hold one of some words, by their paths."""
    source = ROOT / "src/maidenflight"
    texts = {str(path.relative_to(source)): path.read_text() for path in source.rglob("*.py")}
    return {
        file: ast.parse(text) for file, text in texts.items() if any(word in text for word in words)
    }


def named_in_source(*words: str) -> set[str]:
    """The source files in whose code one of some words is an identifier or a text by itself."""
    kinds = (ast.Name, "id"), (ast.Attribute, "attr"), (ast.arg, "arg"), (ast.keyword, "arg")
    kinds = (*kinds, (ast.Constant, "value"), (ast.AnnAssign, "target"))
    return {
        file
        for file, tree in trees(*words).items()
        for node in ast.walk(tree)
        if any(isinstance(node, kind) and getattr(node, at) in words for kind, at in kinds)
    }


def test_a_property_of_a_policy_s_input_is_named_in_six_files_and_its_own() -> None:
    """Look-ahead, which touched 33 when it came; its own are arithmetic, C and picture."""
    own = {"simulator/tasks/look_ahead.py", "deployment/look_ahead.py"}
    own |= {"reporting/figures/plots.py"}
    assert named_in_source("look_ahead", "LookAhead") - own == {
        "simulator/policy_spec.py",
        "integrations/raptor/form.py",
        "integrations/px4_network/form.py",
        "policy.py",
        "deployment/c.py",
        "verbs/train.py",
    }


def test_no_function_takes_properties_of_policies_one_by_one() -> None:
    """Verbs have them as fields, which are their options."""
    plain = {field.name: str(field.type) for field in dataclasses.fields(PolicySpec)}
    several = [
        f"{file}: {node.name}"
        for file, tree in trees(*plain).items()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
        and sum(
            one.annotation is not None
            and one.arg in plain
            and ast.unparse(one.annotation).replace(" | None", "") == plain[one.arg]
            for one in [*node.args.args, *node.args.kwonlyargs]
        )
        > 1
    ]
    assert several == []


def test_an_exporter_is_a_file_and_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    file, line = extensions("An exporter")
    Path("scales.py").write_text(file)
    monkeypatch.syspath_prepend(str(Path.cwd()))
    monkeypatch.setitem(EXPORTERS.own, "scales", "")
    run_snippet(line, "docs/extending.md")
    assert len([one for one in line.splitlines() if one and "import" not in one]) == 1
    made = policy.untrained_policy(jax.random.key(0))
    (written,) = mf.export(made, "scales", "scales", name="mine", seed=1, record={})
    assert json.loads(written.read_text())["name"] == "pwm"
    assert written == Path("scales/mine_scales.json")


def test_a_format_of_drones_is_two_functions_in_a_file(monkeypatch: pytest.MonkeyPatch) -> None:
    (snippet,) = extensions("A format of drones")
    monkeypatch.setitem(DRONE_FORMATS.own, "plain", "")
    run_snippet(snippet, "docs/extending.md")
    written = mf.export_drone(mf.drone("x500"), "x500.txt", "plain")
    lines = written.read_text().splitlines()
    assert lines[-1].startswith("mass 2.06")
    assert any(one.startswith("# latency = 0.005 s") for one in lines)


@pytest.fixture
def delay(monkeypatch: pytest.MonkeyPatch) -> type[Verb]:
    """The verb of the page on extending, in a module that Python finds."""
    (file,) = extensions("A verb")
    Path("delay.py").write_text(file)
    monkeypatch.syspath_prepend(str(Path.cwd()))
    monkeypatch.delitem(sys.modules, "delay", raising=False)
    return find_verb("delay:Delay")


def test_a_verb_is_a_file_and_a_line(
    delay: type[Verb], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = " ".join(section("docs/extending.md", "A verb").split())
    (line,) = re.findall(r'`("delay": "[^`]*)`', page)
    monkeypatch.setitem(VERBS.own, *ast.literal_eval(line.replace(":", ",", 1)))
    (command,) = re.findall(r"`maidenflight (delay [^`]*)`", page)
    cli.commands(shlex.split(command), standalone_mode=False)
    by_command = Path("delayed.toml").read_bytes()
    usual = float(parameters.read_drone("x500").latency)
    assert float(parameters.read_drone("delayed.toml").latency) == pytest.approx(usual + 5e-3)
    (call,) = re.findall(r"`(Delay\([^`]*)`", page)
    result = eval(call, {"Delay": delay})
    assert Path("delayed.toml").read_bytes() == by_command
    assert result.record["settings"] == {"drone": "x500", "more": 5.0}
    cli.commands(["--help"], standalone_mode=False)
    assert "Write a DRONE with more latency." in capsys.readouterr().out


def test_an_option_is_the_line_of_a_verb_that_the_page_names(
    delay: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is in the help, the command line, a study with its range, and Python."""
    assert re.findall(r"`(\w+)` above", section("docs/extending.md", "An option")) == ["more"]
    _, declared = delay.settings()["more"]
    assert (declared.default_text, declared.values.expected) == ("10.0", "a number from 0 to 100")
    monkeypatch.setitem(VERBS.own, "delay", "delay:Delay")
    for words in ("--help", "--more 101"):
        told = CliRunner().invoke(cli.commands, ["delay", *words.split()]).output
        assert {"--help": "What is added [ms].", "--more 101": "from 0 to 100"}[words] in told
    entry = {"name": "a", "kind": "delay", "grid": {"more": [1, 2]}}
    assert [task.settings["more"] for task in study.of([entry]).tasks] == [1, 2]
    with pytest.raises(InputError, match="more = '101'"):
        study.of([{"name": "a", "kind": "delay", "settings": {"more": 101}}])
    with pytest.raises(InputError, match="more = '101'"):
        delay(more=101)


@pytest.mark.slow
def test_a_verb_of_ones_own_is_swept_as_the_page_on_clusters_tells(delay: type[Verb]) -> None:
    Path("study.toml").write_text(blocks("docs/clusters.md", "toml")[1])
    (snippet,) = blocks("docs/clusters.md", "python")
    snippet = snippet.replace('on="local"', 'on="local", trust=True')
    table = run_snippet(snippet, "docs/clusters.md", {"__name__": "__main__"})["table"]
    usual = float(parameters.crazyflie().latency)
    assert table["late.more"].to_list() == list(range(1, 11))
    assert table["latency"].to_list() == pytest.approx(
        [usual + 1e-3 * more for more in range(1, 11)]
    )
    assert len(list(Path("study/results").rglob("delayed.toml"))) == 10
    assert Path("study/study.csv").exists()


def test_the_study_of_the_page_on_clusters_has_as_many_tasks_as_it_says() -> None:
    Path("study.toml").write_text(blocks("docs/clusters.md", "toml")[0])
    kinds = Counter(task.kind for task in study.read_study("study.toml").tasks)
    assert kinds == {"train": 40, "transfer": 40}
    page = (ROOT / "docs/clusters.md").read_text()
    assert "This one has 40 tasks that train and 40 that fly." in page


@pytest.mark.slow
def test_the_python_of_the_page_on_commands_runs(capsys: pytest.CaptureFixture[str]) -> None:
    parameters.write_drone("drone.toml", parameters.crazyflie(), {})
    (snippet,) = blocks("docs/api/index.md", "python")
    # By the program of the README's training.
    less = snippet.replace("updates=200", "updates=2, yaw_penalty=0.1")
    assert less != snippet
    run_snippet(less, "docs/api/index.md")
    assert "survival" in capsys.readouterr().out
    assert Path("policies/policy_3.json").exists()


def test_the_snippet_for_a_drone_of_ones_own_writes_it() -> None:
    run_python("docs/quickstart.md", "PX4 or Betaflight")
    assert float(parameters.read_drone("mine.toml").mass) == pytest.approx(1.3)


@pytest.mark.night
@pytest.mark.parametrize("tab", ["Crazyflie", "PX4 or Betaflight", "No drone: the paper"])
def test_the_commands_of_a_first_hour_run(
    tab: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number, flight in enumerate(recorded_flights()):
        for folder in ("flights", "more_flights", "blackbox_flights", "authors_flights/pwm"):
            flight_csv.write(f"{folder}/flight_{number}.csv", flight)
    parameters.write_drone("mine.toml", parameters.crazyflie(), {})
    for name in ("pwm_024", "attitude_rate_066", "attitude_021"):
        policy_file.write_policy(f"{name}.json", policy.untrained_policy(jax.random.key(0)))
    assert run_commands(blocks("docs/quickstart.md", "sh", tab), monkeypatch) >= 6
    assert (tmp_path / "report.html").exists()


def sentences(page: Path) -> list[str]:
    """The sentences of a page's prose: no code, tables, headings, front matter or link targets."""
    text = re.sub(r"^( *)```.*?^\1```|\A---\n.*?^---", "", page.read_text(), flags=re.M | re.S)
    text = re.sub(r"^ *(\||#|=== |:::| {8}).*$", "\n", text, flags=re.M)
    text = re.sub(r"^ *([-*]|\d+\.) ", "\n", text, flags=re.M)
    text = re.sub(r"\]\([^)]*\)", "]", text).replace("et al. ", "et al ")
    return [
        sentence
        for paragraph in re.split(r"\n\s*\n", text)
        for sentence in re.split(r"(?<=[.!?])[*_)\"]*\s+", " ".join(paragraph.split()))
        if sentence
    ]


def test_the_documentation_for_users_is_short_and_so_are_its_sentences() -> None:
    # Marks of tables are no words.
    words = {page: len(re.findall(r"(?<!\S)[^\s|]\S*", page.read_text())) for page in GUIDES}
    assert words[ROOT / "README.md"] <= 400
    assert sum(words.values()) <= 16_000
    spoken = [sentence for page in GUIDES for sentence in sentences(page)]
    long = [sentence for sentence in spoken if len(sentence.split()) > 25]
    assert len(spoken) > 500
    assert len(long) <= 0.05 * len(spoken), long


def test_the_gallery_shows_small_pictures_and_all_of_its_folder() -> None:
    folder = ROOT / "docs" / "gallery"
    page = (folder.parent / "gallery.md").read_text()
    shown = set(re.findall(r"\]\(gallery/([\w.]+)\)", page))
    assert {path.name for path in folder.iterdir()} == shown
    assert all(path.stat().st_size < 200_000 for path in folder.iterdir())


def test_the_tour_leads_through_fifteen_files_that_are_there_and_not_longer_than_it_says() -> None:
    rows = re.findall(
        r"^(\d+)\. `([\w/]+\.py)` \((\d+)\): (.+?\.) (.+\?)$",
        (ROOT / "CONTRIBUTING.md").read_text(),
        re.M,
    )
    assert [int(number) for number, *_ in rows] == list(range(1, 16))
    assert len({file for _, file, *_ in rows}) == 15
    for _, file, most, *_ in rows:
        lines = (ROOT / "src" / "maidenflight" / file).read_text().count("\n")
        assert int(most) - 100 < lines <= int(most), file
