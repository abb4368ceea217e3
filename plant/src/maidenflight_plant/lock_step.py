"""A simulated drone as the physics of a firmware in another process, which time waits for.

Two messages, little endian, alternate. The plant says what the sensors show, the firmware what the
motors get; then a millisecond of flight passes, and no more until the next answer. Equal answers
get equal bytes.

| message | bytes | layout |
|---|---|---|
| `SENSORS`, plant to firmware | 76 | uint32 step, uint32 fresh, 17 float32 |
| `MOTORS`, firmware to plant | 12 | uint32 step, 4 uint16 PWM |

`fresh` is 1 where pose, range and flow were read anew, every 10 ms. The 17 numbers are gyro [rad/s]
(3), accelerometer [m/s2] (3), position [m] (3), quaternion x y z w (4), range [m], flow [rad/s] (2)
and battery [V]; see `running_plant.Readings`. The step of an answer is that of the message that
it answers.
"""

import socket
import struct
import time
from collections.abc import Callable, Iterator
from typing import BinaryIO, NamedTuple

import numpy as np

from maidenflight.errors import InputError
from maidenflight_plant.running_plant import POSE_EVERY, SIZE, RunningPlant

SENSORS = struct.Struct(f"<II{SIZE}f")
MOTORS = struct.Struct("<I4H")
HELLO = 0xFFFFFFFF
"""Step of the message by which a firmware begins a flight by UDP; the drone is put on the floor."""
ANSWER_TIMEOUT_S = 0.2
"""Time after which a message that was not answered is sent again [s]."""
PEER_TIMEOUT_S = 5.0
"""Time without an answer after which nothing is sent any more [s], and another sender may begin a
flight; the firmware itself may still go on, as behind a debugger's break."""


class Served(NamedTuple):
    """How a flight went."""

    steps: int
    """Milliseconds of flight."""
    position: tuple[float, float, float]
    """Where it ended [m]."""


def sensors(plant: RunningPlant) -> bytes:
    """Returns the message of the present."""
    fresh = plant.number % POSE_EVERY == 0
    return SENSORS.pack(plant.number, fresh, *plant.readings.tolist())


def step_once(plant: RunningPlant, answer: bytes) -> bool:
    """Flies a millisecond by an answer; not by one to another message.

    Raises:
        InputError: it is no answer.
    """
    if len(answer) != MOTORS.size:
        raise InputError(
            f"plant: an answer of {len(answer)} bytes; expected {MOTORS.size}: uint32 step, 4 "
            "uint16 PWM, little endian."
        )
    step, *pwm = MOTORS.unpack(answer)
    if step != plant.number:
        return False
    plant.step(np.array(pwm, np.float32))
    return True


def by_pipe(plant: RunningPlant, reader: BinaryIO, writer: BinaryIO, steps: int | None) -> Served:
    """Serves a flight by two streams until the firmware closes its own.

    Args:
        plant: what flies.
        reader: of the firmware's answers.
        writer: to the firmware.
        steps: most milliseconds; any number by default.

    Raises:
        InputError: an answer is none, or of another step.
    """
    while steps is None or plant.number < steps:
        try:
            writer.write(sensors(plant))
            writer.flush()
        except BrokenPipeError:
            break
        answer = reader.read(MOTORS.size)
        if not answer:
            break
        if not step_once(plant, answer):
            raise InputError(
                f"plant: an answer to step {MOTORS.unpack(answer)[0]} of the message of step "
                f"{plant.number}. Answer each message once, with its step."
            )
    return _served(plant)


def by_udp(
    begin: Callable[[], RunningPlant], address: tuple[str, int], steps: int | None
) -> Iterator[Served]:
    """Serves flights by datagrams, one after the other.

    A flight begins with a message of step `HELLO` from the firmware and ends with the next one, or
    after so many steps. Other senders are passed over until the firmware is silent for
    `PEER_TIMEOUT_S`. A message without an answer is sent again; late answers and what is no
    message are passed over.

    Args:
        begin: makes the plant of a flight.
        address: where to listen: host and port.
        steps: most milliseconds of a flight; any number by default.

    Yields:
        Each flight that ended.

    Raises:
        InputError: the address cannot be had.
    """
    with listening(address, "Give another with --udp HOST:PORT.") as line:
        line.settimeout(ANSWER_TIMEOUT_S)
        plant: RunningPlant | None = None
        peer: tuple[str, int] | None = None
        answered_at = time.monotonic()

        def silent() -> bool:
            return time.monotonic() - answered_at > PEER_TIMEOUT_S

        while True:
            try:
                answer, sender = line.recvfrom(4 * MOTORS.size)
            except TimeoutError:
                if plant is not None and peer is not None and not silent():
                    line.sendto(sensors(plant), peer)
                continue
            if len(answer) != MOTORS.size:
                continue
            is_hello = MOTORS.unpack(answer)[0] == HELLO
            if plant is not None and sender != peer and not (is_hello and silent()):
                continue
            answered_at = time.monotonic()
            if is_hello:
                if plant is not None and plant.number:
                    yield _served(plant)
                if plant is None or plant.number:
                    plant = begin()
                peer = sender
            elif plant is None or not step_once(plant, answer):
                continue
            if steps is not None and plant.number >= steps:
                yield _served(plant)
                plant = None
            else:
                line.sendto(sensors(plant), sender)


def listening(address: tuple[str, int], advice: str) -> socket.socket:
    """Returns a socket for datagrams that listens at a host and port.

    Raises:
        InputError: the address cannot be had; `advice` says what to do then.
    """
    line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        line.bind(address)
    except OSError as error:
        line.close()
        place = f"{address[0]}:{address[1]}"
        raise InputError(f"plant: cannot listen at {place} ({error.strerror}). {advice}") from error
    return line


def _served(plant: RunningPlant) -> Served:
    x, y, z = np.asarray(plant.state.position).tolist()
    return Served(plant.number, (x, y, z))
