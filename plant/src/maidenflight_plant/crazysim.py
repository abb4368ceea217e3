"""A simulated drone as the physics of CrazySim, the firmware's build for a computer, by UDP.

CrazySim does not wait: a step is made each millisecond of the clock. It compensates for no battery,
so that PWM is the thrust command. Packets that are neither sensors nor motors are passed between
the firmware and the ground (cflib at `udp://127.0.0.1:19850`).

Source: the protocol of CrazySim's branch of 2024, described from reading and tried with a bridge;
this module itself was tried only with a stand-in.
"""

import socket
import struct
import time
from collections.abc import Callable

import numpy as np

from maidenflight_plant.lock_step import listening
from maidenflight_plant.running_plant import POSE_EVERY, STEP, RunningPlant

FIRMWARE_PORT, GROUND_PORT = 19950, 19850
HANDSHAKE, PROBE = b"\xf3", b"\xff"
IMU = struct.Struct("<BB6h")
"""Header, 0, accelerometer [32 g / 65536], gyro [4000 deg/s / 65536]."""
POSE = struct.Struct("<BB7f")
"""Header, 8, position [m], quaternion x y z w."""
IMU_HEADER, POSE_HEADER, MOTOR_PORT = 0x9C, 0x6D, 9
_PER_G, _PER_DEGREE = 65536 / 32, 65536 / 4000
_GRAVITY = 9.80665


def imu(plant: RunningPlant) -> bytes:
    """Returns a packet of accelerometer and gyro."""
    acceleration = plant.readings[3:6] / _GRAVITY * _PER_G
    rates = np.degrees(plant.readings[:3]) * _PER_DEGREE
    counts = np.clip(np.round(np.concatenate([acceleration, rates])), -32768, 32767)
    return IMU.pack(IMU_HEADER, 0, *counts.astype(int).tolist())


def pose(plant: RunningPlant) -> bytes:
    """Returns the position and attitude, as a motion capture sends them."""
    return POSE.pack(POSE_HEADER, 8, *plant.readings[6:13].tolist())


def motors(packet: bytes) -> np.ndarray | None:
    """Returns the PWM [counts] of a packet of the firmware; None of any other packet."""
    if len(packet) == 9 and packet[0] >> 4 == MOTOR_PORT:
        return np.array(struct.unpack("<4H", packet[1:]), np.float32)
    return None


def serve(
    plant: RunningPlant,
    steps: int | None,
    ports: tuple[int, int] = (FIRMWARE_PORT, GROUND_PORT),
    clock: Callable[[], float] = time.monotonic,
) -> int:
    """Serves a firmware as fast as the clock goes.

    Args:
        plant: what flies; a drone without a thrust law.
        steps: most milliseconds; any number by default.
        ports: where the firmware and the ground send to, on this machine.
        clock: seconds.

    Returns:
        Milliseconds of flight.

    Raises:
        InputError: a port is taken.
    """
    with _bound(ports[0]) as firmware, _bound(ports[1]) as ground:
        pwm = np.zeros(4, np.float32)
        peers: dict[str, tuple[str, int]] = {}
        begun = None
        while steps is None or plant.number < steps:
            for packet, sender in _waiting(firmware):
                peers["firmware"] = sender
                command = motors(packet)
                if packet[:1] == HANDSHAKE and len(packet) == 1:
                    firmware.sendto(HANDSHAKE, sender)
                    begun = clock() - plant.number * STEP
                elif command is not None:
                    pwm = command
                elif "ground" in peers:
                    ground.sendto(packet, peers["ground"])
            for packet, sender in _waiting(ground):
                peers["ground"] = sender
                if packet == PROBE:
                    ground.sendto(PROBE, sender)
                elif "firmware" in peers:
                    firmware.sendto(packet, peers["firmware"])
            if begun is None or clock() < begun + (plant.number + 1) * STEP:
                time.sleep(STEP / 10)
                continue
            plant.step(pwm)
            firmware.sendto(imu(plant), peers["firmware"])
            if plant.number % POSE_EVERY == 0:
                firmware.sendto(pose(plant), peers["firmware"])
        return plant.number


def _waiting(line: socket.socket) -> list[tuple[bytes, tuple[str, int]]]:
    """Receives the datagrams that have come."""
    processes = []
    while True:
        try:
            packet, sender = line.recvfrom(1024)
        except BlockingIOError:
            return processes
        if packet:
            processes.append((packet, sender))


def _bound(port: int) -> socket.socket:
    line = listening(("127.0.0.1", port), "Is another CrazySim running?")
    line.setblocking(False)
    return line
