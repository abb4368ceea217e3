"""One task, done where an engine brings it: in a process of its own machine or of another."""

import json
import os
import signal
import threading
import time
import traceback
from contextlib import chdir
from dataclasses import dataclass
from typing import Any

from maidenflight import __version__, cache, compiler, results
from maidenflight.errors import InputError
from maidenflight.studies import store
from maidenflight.verb import Verb, find_verb

DONE, FAILED, LOST = "done", "failed", "lost"
"""How a task ends: its result is there, its function raised, or its process or node is gone."""


@dataclass(frozen=True)
class Order:
    """A task as a worker gets it: plain values only."""

    key: str
    kind: str
    label: str
    settings: dict[str, Any]
    inputs: dict[str, tuple[str, str]]
    """Settings that other tasks made: their key, and the file of their folder."""
    home: str
    """The study's folder, which paths are relative to."""
    store: str
    """Address of the results."""
    cpus: int = 1
    gpus: int = 0


@dataclass(frozen=True)
class TaskResult:
    """How a task ended."""

    key: str
    outcome: str
    """`DONE`, `FAILED` or `LOST`."""
    message: str = ""
    """The traceback of one that failed, or what is known of one that was lost."""


def perform(order: Order) -> TaskResult:
    """Does a task, unless its result is there already; what it raises is an `TaskResult` too."""
    try:
        task_store = store.opened(order.store)
        if task_store.has(order.key):
            return TaskResult(order.key, DONE)
        compiler.set_flags(compiler.QUICK)
        cache.keep_compiled()
        verb = find_verb(order.kind)
        if verb.parallel:
            compiler.as_devices(order.cpus)
        input_paths = {
            name: str(task_store.folder(key) / product)
            for name, (key, product) in order.inputs.items()
        }
        with task_store.making(order.key) as folder, chdir(order.home):
            task = verb.from_settings({**order.settings, **_by_kind(verb, input_paths)})
            path = folder / product_of(verb)
            rows = task.run(path).rows
            task.discard_state(path)
            record = {
                "version": __version__,
                "kind": order.kind,
                "settings": order.settings,
                "inputs": {name: key for name, (key, _) in order.inputs.items()},
                "cpus": order.cpus,
                "gpus": order.gpus,
            }
            content = json.dumps({"record": record, "rows": list(rows)}, indent=1)
            results.write(folder / store.RESULT, f"{content}\n")
    except InputError as error:
        return TaskResult(order.key, FAILED, f"{error}\n")
    except (Exception, SystemExit):
        return TaskResult(order.key, FAILED, traceback.format_exc())
    return TaskResult(order.key, DONE)


def product_of(verb: type[Verb]) -> str:
    """Returns where a task writes, in its folder; later tasks take it from there."""
    return verb.output.default or "output"


def _by_kind(verb: type[Verb], input_paths: dict[str, str]) -> dict[str, Any]:
    """Returns what other tasks made, alone in a list where a setting takes lists."""
    repeats = {name for name, (_, setting) in verb.settings().items() if setting.values.repeats}
    return {name: [path] if name in repeats else path for name, path in input_paths.items()}


def begin(driver: int, gpus: str) -> None:
    """Makes this process leave Ctrl-C to its driver, and end soon after that does.

    Args:
        driver: process that this is a child of.
        gpus: those that JAX is to see here, with commas between them.
    """
    os.environ["CUDA_VISIBLE_DEVICES"] = gpus
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == driver:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, name="driver", daemon=True).start()
