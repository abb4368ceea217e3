"""CrazySim's messages, and a stand-in that speaks them."""

import socket
import struct
import threading
import time

import numpy as np
import pytest

from maidenflight.errors import InputError
from maidenflight_plant import crazysim
from maidenflight_plant.running_plant import find_plant


@pytest.fixture(scope="module")
def plant():
    return find_plant("virtual:7", 0, compensated=False)()


def test_at_rest_the_accelerometer_counts_one_g_and_the_pose_is_the_start(plant):
    header, kind, *counts = struct.unpack("<BB6h", crazysim.imu(plant))
    assert (header, kind) == (0x9C, 0)
    np.testing.assert_allclose(counts[:3], [0, 0, 2048], atol=60)
    np.testing.assert_allclose(np.array(counts[3:]) * 4000 / 65536, 0, atol=3)
    header, kind, *pose = struct.unpack("<BB7f", crazysim.pose(plant))
    assert (header, kind) == (0x6D, 8)
    np.testing.assert_allclose(pose[3:], [0, 0, 0, 1], atol=0.01)


def test_motor_packets_are_known_by_their_port():
    packet = bytes([0x90]) + struct.pack("<4H", 1, 2, 3, 65535)
    np.testing.assert_array_equal(crazysim.motors(packet), [1, 2, 3, 65535])
    assert crazysim.motors(bytes([0x50]) + packet[1:]) is None
    assert crazysim.motors(packet[:-1]) is None


def free_ports():
    lines = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
    for line in lines:
        line.bind(("127.0.0.1", 0))
    ports = tuple(line.getsockname()[1] for line in lines)
    for line in lines:
        line.close()
    return ports


def test_a_stand_in_shakes_hands_flies_and_talks_to_the_ground(plant):
    ports = free_ports()
    flown = []
    server = threading.Thread(
        target=lambda: flown.append(crazysim.serve(plant, 200, ports)), daemon=True
    )
    server.start()
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as firmware,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground,
    ):
        for line, port in ((firmware, ports[0]), (ground, ports[1])):
            line.settimeout(60)
            line.connect(("127.0.0.1", port))
        shaken = b""
        while shaken != crazysim.HANDSHAKE:
            try:
                ground.send(crazysim.PROBE)
                firmware.send(crazysim.HANDSHAKE)
                shaken = firmware.recv(100)
            except ConnectionRefusedError:
                time.sleep(0.01)

        def from_drone() -> bytes:
            """What the ground hears; a probe that came before the port was open is sent again."""
            while True:
                try:
                    return ground.recv(100)
                except ConnectionRefusedError:
                    ground.send(crazysim.PROBE)

        assert from_drone() == crazysim.PROBE
        ground.send(b"\x15question")
        firmware.send(b"\x15answer")
        firmware.send(bytes([0x90]) + struct.pack("<4H", *[50000] * 4))
        heard = [firmware.recv(100) for _ in range(150)]
        answer = crazysim.PROBE
        while answer == crazysim.PROBE:
            answer = from_drone()
        assert answer == b"\x15answer"
    server.join(60)
    assert flown == [200]
    assert b"\x15question" in heard
    kinds = [packet[0] for packet in heard]
    assert 9 <= kinds.count(0x9C) / kinds.count(0x6D) <= 11
    assert float(plant.state.rotor_speed.min()) > 0.3


def test_a_port_that_is_taken_is_refused(plant):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        with pytest.raises(InputError, match="Is another CrazySim running"):
            crazysim.serve(plant, 1, (taken.getsockname()[1], free_ports()[0]))
