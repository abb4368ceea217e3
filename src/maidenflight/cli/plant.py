"""plant: a simulated drone as the physics of a firmware that runs elsewhere."""

import sys
import time

import click

from maidenflight.cli import options

_ADDRESS = "127.0.0.1:19960"


def _address(_: click.Context, __: click.Parameter, given: str | None) -> tuple[str, int] | None:
    if given is None:
        return None
    host, _colon, port = given.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise click.BadParameter(f"{given!r}; expected HOST:PORT, such as {_ADDRESS}.")
    return host, int(port)


@click.command()
@click.argument("drone")
@click.option("--pipe", is_flag=True, help="Serve one flight by standard input and output.")
@click.option(
    "--udp",
    metavar="HOST:PORT",
    callback=_address,
    help=f"Serve flights by datagrams at this address; {_ADDRESS} unless another way is given.",
)
@click.option(
    "--crazysim",
    is_flag=True,
    help="Serve CrazySim by its own UDP messages, as fast as the clock goes.",
)
@click.option(
    "--duration",
    type=options.Range(0.001, 86400.0),
    help="Seconds of flight at most; without end unless given.",
)
@options.seed
def plant(
    drone: str,
    pipe: bool,
    udp: tuple[str, int] | None,
    crazysim: bool,
    duration: float | None,
    seed: int,
) -> None:
    """Serve a simulated DRONE to a firmware elsewhere.

    DRONE is a drone's TOML file or name, or near:SEED, virtual:SEED or far:SEED. Sensors go out,
    motor PWM comes in, and a millisecond of flight passes only when it has: docs/plant.md has the
    two messages. With --crazysim time does not wait.
    """
    if pipe + crazysim + (udp is not None) > 1:
        raise click.UsageError("--pipe, --udp and --crazysim are three ways. Give one.")
    from maidenflight import workflow
    from maidenflight.link import crazysim as by_crazysim
    from maidenflight.link import lock_step

    def say(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    steps = None if duration is None else round(duration * 1000)
    begin = workflow.plant(drone, seed, compensated=not crazysim)
    begun = time.monotonic()

    def ended(flown: int) -> None:
        seconds = time.monotonic() - begun
        say(f"{flown / 1000:g} s of simulated flight in {seconds:.3g} s")

    if crazysim:
        say(f"waiting for CrazySim at port {by_crazysim.FIRMWARE_PORT}; Ctrl-C ends")
        ended(by_crazysim.serve(begin(), steps))
    elif pipe:
        ended(lock_step.by_pipe(begin(), sys.stdin.buffer, sys.stdout.buffer, steps).steps)
    else:
        host, port = udp or tuple(_ADDRESS.split(":"))
        say(f"waiting for a firmware at {host}:{port}; Ctrl-C ends")
        for flight in lock_step.by_udp(begin, (host, int(port)), steps):
            ended(flight.steps)
            begun = time.monotonic()
