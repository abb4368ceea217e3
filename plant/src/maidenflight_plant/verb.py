"""`Plant`, the command `maidenflight plant`: a simulated drone for a firmware elsewhere."""

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from maidenflight.settings import flag, number, setting, text, whole
from maidenflight.verb import Output, Progress, Result, Verb

if TYPE_CHECKING:
    from maidenflight_plant.running_plant import RunningPlant

ADDRESS = "127.0.0.1:19960"
"""Where datagrams are served by default."""


def is_address(value: object) -> bool:
    """Tests whether a value is HOST:PORT."""
    host, _, port = value.rpartition(":") if isinstance(value, str) else ("", "", "")
    return bool(host) and port.isdecimal() and 0 < int(port) < 65536


class Plant(Verb):
    """Simulate DRONE as the physics of a firmware that runs elsewhere.

    Sensors go out, motor PWM comes in, and a millisecond of flight passes only when it has. DRONE
    is a drone's TOML file or name, or near:, virtual: or far:SEED.
    """

    in_studies, replaces = False, False
    output = Output(None, "Nothing is written.")

    drone: str = setting(text("a drone's name or TOML file", "DRONE"), argument=True)
    pipe: bool = setting(flag(), False, "Serve one flight by standard input and output.")
    udp: str = setting(
        text("HOST:PORT", "HOST:PORT"), ADDRESS, "Serve flights by datagrams at this address."
    )
    crazysim: bool = setting(
        flag(), False, "Speak CrazySim's own messages, as fast as the clock goes."
    )
    duration: float | None = setting(number(0.001, 86400), None, "Seconds of a flight at most.")
    seed: int = setting(whole(0, 2**31 - 1), 0, "Random seed of the noise.")

    def check_early(self) -> None:
        """Refuses an address that is none, and two ways at once.

        Raises:
            InputError: which.
        """
        from maidenflight.errors import InputError

        if not is_address(self.udp):
            raise InputError(f"--udp {self.udp}: expected HOST:PORT, such as {ADDRESS}.")
        if self.pipe + self.crazysim + (self.udp != ADDRESS) > 1:
            raise InputError("--pipe, --udp and --crazysim exclude each other. Give one.")

    def compute(self, output: Path | None, progress: Progress) -> Result:
        """Serves flights until the other side, the duration or Ctrl-C ends them."""
        from maidenflight_plant.running_plant import find_plant

        begin = find_plant(self.drone, self.seed, not self.crazysim)
        steps = None if self.duration is None else round(self.duration * 1000)
        return Result({"flights": self._serve(begin, steps)})

    def _serve(self, begin: "Callable[[], RunningPlant]", steps: int | None) -> list[float]:
        """Serves flights; returns how long each was [s]."""
        from maidenflight_plant import crazysim, lock_step

        began, seconds = time.monotonic(), list[float]()

        def end(steps_done: int) -> None:
            nonlocal began
            seconds.append(steps_done / 1000)
            took, began = time.monotonic() - began, time.monotonic()
            say(f"{seconds[-1]:g} s of simulated flight in {took:.3g} s")

        if self.crazysim:
            say(f"waiting for CrazySim at port {crazysim.FIRMWARE_PORT}; Ctrl-C ends")
            end(crazysim.serve(begin(), steps))
        elif self.pipe:
            end(lock_step.by_pipe(begin(), sys.stdin.buffer, sys.stdout.buffer, steps).steps)
        else:
            host, _, port = self.udp.rpartition(":")
            say(f"waiting for a firmware at {self.udp}; Ctrl-C ends")
            if host == "0.0.0.0":
                say("note: any machine of the network may fly this drone")
            for flight in lock_step.by_udp(begin, (host, int(port)), steps):
                end(flight.steps)
        return seconds


def say(line: str) -> None:
    """Prints a line beside the stream of messages."""
    print(line, file=sys.stderr, flush=True)
