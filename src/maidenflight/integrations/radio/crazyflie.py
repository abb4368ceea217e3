"""The connection to a Crazyflie by cflib: log blocks in, a few commands out.

cflib calls back in threads of its own; they write each row to disk before they pass it on, and
never wait.
"""

import logging
import math
import threading
import warnings
from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

from maidenflight import names
from maidenflight.errors import InputError, optional
from maidenflight.integrations.radio.blocks import (
    ACTIVE,
    AHEAD,
    CHARGE,
    ENABLE,
    HASH,
    MOTORS,
    PERIOD,
    PROPELLERS,
    PROPELLERS_PASSED,
    STATE,
    VARIANCE,
    WHY,
    Block,
    Reading,
    reading,
    with_policy,
)
from maidenflight.integrations.radio.clock import Clock
from maidenflight.integrations.radio.row_files import RowFile
from maidenflight.integrations.radio.watch import DECKS, Motion, Vector

CONNECTION_TIMEOUT_S = 60.0
"""Longest wait for a connection with all its tables [s]."""
_TRIES = 20
"""How often a block is started anew to meet the other's instant; one of three tries does."""
_ANSWER = 3.0
"""Longest wait for a block's first packet [s]."""


class Crazyflie:
    """A connected Crazyflie whose rows come in."""

    lost: str
    """Why the link is down; empty while it is up."""
    received: int
    """Packets of log blocks so far."""
    latest: Reading | None
    """What came last."""
    variance: list[Vector]
    """Of the estimated position, all that came [m2]."""
    charge: int
    """State of the charger, a key of `CHARGING` or another."""
    propellers_passed: int
    """Bits of the propeller test."""

    def __init__(
        self,
        uri: str,
        clock: Clock,
        cache: Path | None = None,
        patience: float = CONNECTION_TIMEOUT_S,
    ) -> None:
        """Connects and starts the log blocks.

        Args:
            uri: such as `radio://0/80/2M/E7E7E7E7E7`, or `udp://127.0.0.1:19850` for a simulation.
            clock: the program's.
            cache: folder in which the drone's tables of contents lie, so that the next
                connection is quick.
            patience: longest wait for a connection with all its tables [s].

        Raises:
            InputError: cflib is not installed, nothing answers, or the firmware lacks what is
                needed.
        """
        with optional("cflib", "drone", "the radio link"):
            import cflib.crazyflie
            import cflib.crtp
            from cflib.crazyflie.log import LogConfig
            from cflib.crazyflie.param import ParamTocElement
        self.uri, self.clock = uri, clock
        self.lost, self.received, self.latest, self.variance = "", 0, None, []
        self.charge, self.propellers_passed = 0, 0
        self._echoes: dict[str, float] = {}
        self._seen: set[int] = set()
        self._rows: RowFile | None = None
        self._writing = threading.Lock()
        self._values: dict[str, float] = {}
        self._stamps: dict[str, int] = {}
        self._closed = False
        self._types = {name: code for code, (name, _) in ParamTocElement.types.items()}
        self._config = LogConfig
        # What goes wrong comes back to us, and is reported once.
        logging.getLogger("cflib").setLevel(logging.CRITICAL)
        if not cflib.crtp.CLASSES:
            cflib.crtp.init_drivers()
        self._cf = cflib.crazyflie.Crazyflie(rw_cache=str(cache) if cache else None)
        # Its pings would dead-lock: an error of the link in one thread waits for the pinging one,
        # which waits for the first to send.
        self._cf.link_statistics.start = lambda: None
        self._open(patience)
        try:
            kind = uri.partition("://")[0]
            self.simulated = "" if kind in ("radio", "usb") else kind
            tells = self._has_log(ACTIVE) and self._has_log(WHY)
            self.has_policy = tells and self.parameter(ENABLE) is not None
            self.has_look_ahead = self.parameter(AHEAD) is not None
            self._cf.param.add_update_callback(
                "mf", cb=lambda name, value: self._echoes.update({name: float(value)})
            )
            self.decks = tuple(deck for deck in DECKS if self.parameter(deck) == 1)
            self.blocks = (STATE, with_policy(MOTORS) if self.has_policy else MOTORS)
            self._start_blocks()
        except BaseException:
            self.close()
            raise

    def _open(self, patience: float) -> None:
        ready, reasons = threading.Event(), []

        def reason_in(message: str) -> str:
            return next(iter(message.strip().splitlines()), "no reason")

        def failed(_: str, message: str) -> None:
            reasons.append(reason_in(message))
            ready.set()

        def lost(_: str, message: str) -> None:
            self.lost = reason_in(message)
            failed(_, message)

        self._cf.fully_connected.add_callback(lambda _: ready.set())
        self._cf.connection_failed.add_callback(failed)
        self._cf.connection_lost.add_callback(lost)
        try:
            self._cf.open_link(self.uri)
            answered = ready.wait(patience)
        except BaseException:
            self.close()
            raise
        if reasons or not answered:
            self.close()
            reason = reasons[0] if reasons else f"no answer in {patience:g} s"
            raise InputError(
                f"{self.uri}: no connection ({reason}). Is the drone on, the radio plugged in, the "
                "address right? cfclient finds drones near you."
            )

    def _has_log(self, name: str) -> bool:
        table = self._cf.log.toc
        return table is not None and table.get_element(*name.split(".")) is not None

    def _start_blocks(self) -> None:
        """Starts the blocks, and the motors' again until both tell the same instant."""
        names = chain(*(block.variables for block in (*self.blocks, VARIANCE)))
        missing = [name for name in names if not self._has_log(name)]
        if missing:
            raise InputError(
                f"{self.uri}: the firmware has no log variable {', '.join(missing[:3])}. Flash a "
                "current one."
            )
        state, motors, variance = (self._add(block) for block in (*self.blocks, VARIANCE))
        for block in (state, motors, variance):
            block.start()
        for tries in range(_TRIES):
            before = dict(self._stamps)

            def both_came(before: Mapping[str, int] = before) -> bool:
                stamps = (
                    (self._stamps.get(block.name), before.get(block.name)) for block in self.blocks
                )
                return all(now not in (None, earlier) for now, earlier in stamps)

            self._wait(both_came)
            late = (self._stamps[MOTORS.name] - self._stamps[STATE.name]) % 10
            if late in (9, 0, 1) or tries == _TRIES - 1:
                return
            motors.stop()
            # Packets that are under way still tell the old instant.
            self.clock.sleep(0.05)
            motors.start()

    def _wait(self, done: Callable[[], bool]) -> None:
        until = self.clock.now() + _ANSWER
        while not done():
            if self.lost or self.clock.now() > until:
                reason = self.lost or f"none in {_ANSWER:g} s"
                raise InputError(
                    f"{self.uri}: connected, but rows do not come ({reason}). Try again, nearer."
                )
            self.clock.sleep(0.01)

    def _add(self, block: Block) -> Any:
        config = self._config(block.name, round(block.period * 1000))
        for name, kind in block.variables.items():
            config.add_variable(name, kind)
        config.data_received_cb.add_callback(
            lambda stamp, values, _: self._take(block.name, stamp, values)
        )
        self._cf.log.add_config(config)
        return config

    def _take(self, block: str, stamp: int, values: Mapping[str, float]) -> None:
        now = self.clock.now()
        if block == VARIANCE.name:
            x, y, z, *_ = values.values()
            self.variance.append((x, y, z))
            self.charge = int(values[CHARGE])
            self.propellers_passed = int(values[PROPELLERS_PASSED])
        else:
            with self._writing:
                if self._rows is not None:
                    self._rows.append(stamp, now, values)
            self._values |= values
            self._stamps[block] = stamp
            if block == STATE.name:
                self._seen.add(stamp)
            received = now if block == STATE.name or self.latest is None else self.latest.received
            if len(self._stamps) > 1:
                self.latest = reading(self._values, received)
        self.received += 1

    def write_to(self, rows: RowFile | None) -> None:
        """Writes rows to a file from now on; nowhere where there is none."""
        with self._writing:
            self._rows = rows

    def parameter(self, name: str) -> float | None:
        """Returns a parameter's value on connecting; None where the firmware has none such."""
        if self._cf.param.toc.get_element(*name.split(".")) is None:
            return None
        return float(self._cf.param.get_value(name))

    @property
    def identity(self) -> dict[str, str]:
        """Identifier of the processor, firmware's commit, policy and propellers of the app.

        Empty where the firmware does not tell. Source: firmware 2026.08, system.c and version.c.
        """
        words = [self.parameter(f"cpu.id{number}") for number in range(3)]
        commit = [self.parameter(f"firmware.revision{number}") for number in (0, 1)]
        hashed, number = self.parameter(HASH), self.parameter(PROPELLERS)
        propellers = {None: "", **dict(enumerate(names.PROPELLERS))}
        return {
            "drone": _hexadecimal(words, (8, 8, 8)),
            "firmware": _hexadecimal(commit, (8, 4)),
            "on_board": _hexadecimal([hashed], (8,)),
            "propellers": propellers.get(number, "unknown"),
        }

    def count_rows(self) -> None:
        """Begins to count anew the rows that `link_quality` judges."""
        self._seen = set()

    @property
    def link_quality(self) -> float:
        """Share of the rows since `count_rows` that came, 0 to 1."""
        sequence = sorted(self._seen)
        if len(sequence) < 2:
            return 0.0
        expected = 1 + (sequence[-1] - sequence[0]) % (1 << 24) / (1000 * PERIOD)
        return min(len(sequence) / expected, 1.0)

    def confirm(self, values: Mapping[str, float]) -> None:
        """Sets parameters of the app and asks for them; `unconfirmed` tells what came back."""
        for name, value in values.items():
            self.set(name, value)
            if not self.lost and self._cf.param.toc.get_element(*name.split(".")) is not None:
                self._cf.param.request_param_update(name)

    def unconfirmed(self, values: Mapping[str, float]) -> list[str]:
        """Lists parameters of the app that the drone has not echoed as they were set."""
        return [
            name
            for name, value in values.items()
            if not math.isclose(self._echoes.get(name, math.nan), value, rel_tol=1e-6)
        ]

    def set(self, name: str, value: float) -> None:
        """Sets a parameter, at once and without waiting for the answer."""
        self._echoes.pop(name, None)
        element = self._cf.param.toc.get_element(*name.split("."))
        # A lost link has taken the table with it.
        if element is not None:
            kind = element.ctype
            number = value if kind in ("float", "FP16", "double") else int(value)
            self._cf.param.set_value_raw(name, self._types[kind], number)

    def go_to(self, position: Vector, yaw: float = 0.0, motion: Motion | None = None) -> None:
        """Asks for a position [m] and a yaw [rad]; with a motion, for full states of the commander.

        To be repeated, for 0.5 s later the drone only levels itself.
        """
        if motion is None:
            self._cf.commander.send_position_setpoint(*position, math.degrees(yaw))
            return
        turned = (0.0, 0.0, math.sin(yaw / 2.0), math.cos(yaw / 2.0))
        self._cf.commander.send_full_state_setpoint(position, *motion, turned, 0.0, 0.0, 0.0)

    def stop(self) -> None:
        """Stops the motors and disarms."""
        self._cf.commander.send_stop_setpoint()
        self.arm(False)

    def arm(self, armed: bool) -> None:
        """Arms or disarms."""
        with warnings.catch_warnings():
            # Firmware before the supervisor's own port answers in the old way; there is nothing to
            # warn of.
            warnings.simplefilter("ignore")
            self._cf.supervisor.send_arming_request(armed)

    def close(self) -> None:
        """Ends the connection."""
        if not self._closed:
            self._closed = True
            self._cf.incoming.stop()
            self._cf.close_link()


def _hexadecimal(parts: Sequence[float | None], digits: Sequence[int]) -> str:
    """Whole numbers in so many hexadecimal digits each; nothing of those that are not known."""
    known = zip(parts, digits, strict=True)
    return "".join(f"{int(part):0{count}x}" for part, count in known if part is not None)
