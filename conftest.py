"""Strict JAX, so that no shape or dtype is guessed, and the same examples from hypothesis on every
run; the authors' data where it is.
"""

import gc
import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path

# Compilation is most of what tests take: what one process compiled the others read, and so does the
# next run. Small programs too, of which tests have hundreds a file: to read one takes a third of
# compiling it, and to write one nothing that can be measured.
os.environ.setdefault(
    "JAX_COMPILATION_CACHE_DIR", str(Path(__file__).parent / ".pytest_cache" / "xla")
)
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")

# Matrices are small, and waking a second core for each costs a hundred times what it computes.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Tests read lines as pipes have them, whatever terminal they are begun in.
os.environ.pop("COLUMNS", None)

import jax
import pytest
from hypothesis import settings

from commands import Command, run
from maidenflight import compiler

# Tests compile much and compute little: XLA's older emitter, where it has one, is a third faster,
# and each program in one piece takes a sixth less processor time than in pieces for several cores.
# With a space more than there, so that commands take the flags for the user's own and keep them:
# all tests share what is compiled.
smallest = f"{compiler.SMALLEST} --xla_cpu_parallel_codegen_split_count=1"
os.environ.setdefault(
    "XLA_FLAGS", f"{compiler.QUICK} {smallest if compiler.has_older_emitter() else ''} "
)
# And without optimization, a quarter less again, but for what `COMPUTING` names.
os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")
# Tracing makes many objects and no cycles, as in the command line.
gc.set_threshold(100_000)
# Whichever test comes first: a command line would make each core a device, and programs for one
# device are others than for two.
jax.devices()
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

settings.register_profile(
    "reproducible", derandomize=True, deadline=None, max_examples=12, database=None
)
settings.register_profile("night", deadline=5000, max_examples=4000, print_blob=True)
settings.load_profile("reproducible")


MOST_MAPPINGS = 20_000
"""Memory mappings of a process above which compiled programs are dropped. Each program holds a few,
and Linux allows 65,530 a process (vm.max_map_count); the compiler aborts at more."""


COMPUTING = {"identification", "disturbances"}
"""Folders, and files, whose tests compute longer than they compile."""


@pytest.fixture(scope="module", autouse=True)
def optimizations(request: pytest.FixtureRequest) -> None:
    """Compiles with optimization what computes long."""
    jax.config.update("jax_disable_most_optimizations", COMPUTING.isdisjoint(request.path.parts))


@pytest.fixture(scope="module", autouse=True)
def compiled_programs_within_limits() -> Iterator[None]:
    """Drops compiled programs between modules, once a process has many."""
    yield
    mappings = Path("/proc/self/maps")
    if mappings.exists() and mappings.read_bytes().count(b"\n") > MOST_MAPPINGS:
        jax.clear_caches()
        gc.collect()


LONGEST = (
    "test_docs.py",
    "test_train.py",
    "test_identify.py",
    "test_demo.py",
    "test_without_state.py",
    "test_cli.py",
    "test_analytic_gradient.py",
    "test_ppo.py",
    "test_transfer.py",
    "test_environment.py",
    "test_gym.py",
)
"""Files that take longest, which go first, lest one worker runs the last of them alone. Those of
the documentation and the command line compile the same, so they do not begin together."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Sorts tests by `LONGEST`; within a file they keep their order. Those of a night are slow."""
    for item in items:
        if item.get_closest_marker("night"):
            item.add_marker("slow")
    places = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.path.name, len(LONGEST)))


@pytest.fixture(autouse=True)
def flags_of_the_compiler_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands that run in this process set them for later ones."""
    monkeypatch.setenv("XLA_FLAGS", os.environ["XLA_FLAGS"])


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Runs commands of the command line in this process."""
    return partial(run, monkeypatch, capsys)


@pytest.fixture(scope="session")
def shared_data():
    """The folder shared/data beside the repository."""
    folder = Path(__file__).parents[1] / "shared" / "data"
    if not (folder / "authors" / "flights" / "pwm").is_dir():
        pytest.skip(f"the authors' flight logs are not at {folder}")
    return folder
