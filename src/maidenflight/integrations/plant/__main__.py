"""Serves a simulated drone as the physics of a firmware elsewhere.

`python -m maidenflight.integrations.plant DRONE`. Sensors go out, motor PWM comes in, and a
millisecond of flight passes only when it has: `lock_step` describes the two messages. With
--crazysim time does not wait.
"""

import argparse
import sys
import time
from collections.abc import Callable, Sequence

from maidenflight.errors import InputError
from maidenflight.integrations.plant import crazysim, lock_step
from maidenflight.integrations.plant.running_plant import RunningPlant, find_plant

ADDRESS = "127.0.0.1:19960"
"""Where datagrams are served by default."""


def _address(text: str) -> tuple[str, int]:
    host, _colon, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise argparse.ArgumentTypeError(f"{text!r}; expected HOST:PORT, such as {ADDRESS}")
    return host, int(port)


def _duration(text: str) -> float:
    seconds = float(text)
    if not 0.001 <= seconds <= 86400:
        raise argparse.ArgumentTypeError(f"{text!r}; expected 0.001 to 86400 seconds")
    return seconds


def main(words: Sequence[str] | None = None) -> None:
    """Serves flights until the other side, the duration or Ctrl-C ends them."""
    parser = argparse.ArgumentParser(
        prog="python -m maidenflight.integrations.plant", description=__doc__
    )
    parser.add_argument("drone", help="a drone's TOML file or name, or near:, virtual: or far:SEED")
    way = parser.add_mutually_exclusive_group()
    way.add_argument("--pipe", action="store_true", help="one flight by standard input and output")
    udp = f"flights by datagrams at HOST:PORT; {ADDRESS} by default"
    way.add_argument("--udp", type=_address, metavar="HOST:PORT", help=udp)
    way.add_argument(
        "--crazysim", action="store_true", help="CrazySim's own messages, as fast as the clock goes"
    )
    parser.add_argument("--duration", type=_duration, help="seconds of flight at most")
    parser.add_argument("--seed", type=int, default=0, help="of the noise (default: 0)")
    options = parser.parse_args(words)
    steps = None if options.duration is None else round(options.duration * 1000)
    try:
        _serve(options, find_plant(options.drone, options.seed, not options.crazysim), steps)
    except InputError as error:
        parser.error(str(error))
    except KeyboardInterrupt:
        sys.exit(130)


def _serve(
    options: argparse.Namespace, begin: Callable[[], RunningPlant], steps: int | None
) -> None:
    began = time.monotonic()

    def say(line: str) -> None:
        print(line, file=sys.stderr, flush=True)

    def end(steps_done: int) -> None:
        say(f"{steps_done / 1000:g} s of simulated flight in {time.monotonic() - began:.3g} s")

    if options.crazysim:
        say(f"waiting for CrazySim at port {crazysim.FIRMWARE_PORT}; Ctrl-C ends")
        end(crazysim.serve(begin(), steps))
    elif options.pipe:
        end(lock_step.by_pipe(begin(), sys.stdin.buffer, sys.stdout.buffer, steps).steps)
    else:
        host, port = options.udp or _address(ADDRESS)
        say(f"waiting for a firmware at {host}:{port}; Ctrl-C ends")
        if host in ("", "0.0.0.0"):
            say("note: any machine of the network may fly this drone")
        for flight in lock_step.by_udp(begin, (host, port), steps):
            end(flight.steps)
            began = time.monotonic()


if __name__ == "__main__":
    main()
