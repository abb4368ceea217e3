"""demo: the full pipeline on a virtual drone."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from maidenflight import compiler, terminal
from maidenflight.cli import options
from maidenflight.terminal import demo_output, flight_output, progress_output

if TYPE_CHECKING:
    from maidenflight.demo import Demo, Plan


@click.command()
@options.output("Folder; the first free of run, run-2, ... unless given.")
@click.option(
    "--seed", default=7, show_default=True, help="Random seed, also of the virtual drone."
)
@options.as_json
@options.overwrite
def demo(output: Path | None, seed: int, as_json: bool, overwrite: bool) -> None:
    """Run the full pipeline on a virtual drone, in minutes.

    It records flights, identifies the drone from them, trains policies, flies them unseen, exports
    the best one and writes a report.
    """
    if output is None:
        output = next(
            path
            for number in range(1, 10**6)
            if not (path := Path("run" if number == 1 else f"run-{number}")).exists()
        )
    else:
        options.must_be_new(output, overwrite)
    compiler.prepare_jax(fused=True)
    from maidenflight.demo import Listener, Plan
    from maidenflight.demo import demo as run

    plan = Plan()
    what = _stages(plan)
    with terminal.progress("demo", None) as move:

        def begin(name: str) -> None:
            print(f"{name:<9} {what[name]}", file=sys.stderr, flush=True)
            move(0, None, f"{name}: compiling and running")

        result = run(
            output,
            seed,
            plan,
            Listener(
                stage=begin,
                identification=lambda now: move(
                    0, None, f"identify: {progress_output.remark(now)}"
                ),
                training=lambda progress: flight_output.scored(
                    move, progress, plan.learner.updates
                ),
            ),
        )
    options.print_notes(result.identification.notes)
    options.emit(as_json, _content(result), lambda: demo_output.summary(result))


def _stages(plan: "Plan") -> dict[str, str]:
    """What each is, in words."""
    return {
        "record": f"{plan.flights} flights of {plan.duration:g} s on a virtual drone (simulated), "
        "flown by the firmware's PID",
        "identify": "motors, delays and whatever else these flights determine",
        "train": f"{plan.policies} policies by gradients through the simulator",
        "transfer": f"{plan.policies * plan.flight_trials} zero-shot flights in the virtual "
        "reality they have not seen",
        "export": "the best policy to C99",
        "report": "one page to look at",
    }


def _content(result: "Demo") -> dict[str, Any]:
    return {
        "parameters": {
            name: {"value": estimate.value, "interval": list(estimate.interval)}
            for name, estimate in result.identification.estimates.items()
        },
        "truth": demo_output.truth(result),
        "notes": result.identification.notes,
        "flights": result.transfer.table.to_dicts(),
        "stages": result.seconds,
        "best": str(result.best),
        "report": str(result.page),
        "simulated": True,
    }
