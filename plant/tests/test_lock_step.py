"""The plant by pipe and by datagrams: messages, order, and flights of a stand-in firmware."""

import hashlib
import io
import socket
import struct
import subprocess
import sys
import threading

import numpy as np
import pytest

import stand_in
from maidenflight.errors import InputError
from maidenflight.simulator.tasks.tasks import STANDING_HEIGHT_M
from maidenflight_plant import lock_step
from maidenflight_plant.running_plant import find_plant

OFF = (0, 0, 0, 0)


def answers(steps, pwm=OFF):
    return b"".join(lock_step.MOTORS.pack(step, *pwm) for step in steps)


def test_by_pipe_each_message_has_its_answer_and_the_end_of_the_stream_ends_it():
    sent = io.BytesIO()
    plant = find_plant("virtual:7", 0)()
    served = lock_step.by_pipe(plant, io.BytesIO(answers(range(25))), sent, None)
    assert served.steps == 25
    assert served.position == (0.0, 0.0, np.float32(STANDING_HEIGHT_M))
    told = list(lock_step.SENSORS.iter_unpack(sent.getvalue()))
    assert [row[0] for row in told] == list(range(26))
    assert [row[0] for row in told if row[1]] == [0, 10, 20]
    assert told[20][7] == pytest.approx(9.81, abs=0.5)
    assert len(sent.getvalue()) == 26 * 76


def test_the_same_answers_get_the_same_bytes_and_the_duration_ends_it():
    streams = []
    for _ in range(2):
        sent = io.BytesIO()
        reader = io.BytesIO(answers(range(100), (40000, 40100, 40200, 40300)))
        assert lock_step.by_pipe(find_plant("virtual:7", 1)(), reader, sent, 30).steps == 30
        assert reader.tell() == 30 * 12
        streams.append(sent.getvalue())
    assert streams[0] == streams[1]


@pytest.mark.parametrize(
    ("stream", "words"),
    [(answers([0, 1, 1]), "step 1 of the message of step 2"), (answers([0])[:7], "7 bytes")],
    ids=["twice", "cut off"],
)
def test_an_answer_that_is_none_is_refused(stream, words):
    plant = find_plant("virtual:7", 0)()
    with pytest.raises(InputError, match=words):
        lock_step.by_pipe(plant, io.BytesIO(stream), io.BytesIO(), None)


def test_by_datagrams_a_lost_answer_is_asked_for_again_and_a_late_one_passed_over():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        address = free.getsockname()
    ended = []

    def serve():
        begin = find_plant("virtual:7", 0)
        for flight in lock_step.by_udp(begin, address, 3):
            ended.append(flight.steps)
            if len(ended) == 2:
                break

    server = threading.Thread(target=serve, daemon=True)
    server.start()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.settimeout(60)
        line.connect(address)

        def heard():
            return lock_step.SENSORS.unpack(line.recv(200))[0]

        def hello():
            while True:  # The server may not listen yet.
                try:
                    line.send(lock_step.MOTORS.pack(lock_step.HELLO, *OFF))
                    line.settimeout(1)
                    return heard()
                except (ConnectionRefusedError, TimeoutError):
                    line.settimeout(60)

        first = hello()
        line.settimeout(60)
        assert first == 0
        assert heard() == 0  # Nothing was answered.
        line.send(answers([0]))
        while (step := heard()) == 0:
            pass
        assert step == 1
        line.send(answers([0]))
        line.send(b"no answer")
        line.send(answers([1]))
        while (step := heard()) == 1:
            pass
        assert step == 2
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.sendto(lock_step.MOTORS.pack(lock_step.HELLO, *OFF), address)
            stranger.settimeout(0.5)
            with pytest.raises(TimeoutError):
                stranger.recv(200)
        assert ended == []
        assert hello() in (0, 2)  # Another flight; a repetition may be on its way.
        for step in range(3):
            line.send(answers([step]))
    server.join(60)
    assert ended == [2, 3]


def test_an_address_that_is_taken_is_refused():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        with pytest.raises(InputError, match="cannot listen"):
            next(lock_step.by_udp(find_plant("virtual:7", 0), taken.getsockname(), 1))


def test_what_has_physics_of_its_own_is_no_plant(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text("from numpy_drone import NumpyDrone")
    with pytest.raises(InputError, match="physics of its own"):
        find_plant("mine:NumpyDrone", 0)


def flown(structure, seconds):
    """A flight by the command, and a digest of all that the plant said."""
    command = [sys.executable, "-m", "maidenflight", "plant", "virtual:7", "--pipe"]
    pilot, said = stand_in.Firmware(structure), hashlib.sha256()
    with subprocess.Popen(
        [*command, "--duration", str(seconds)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as served:
        assert served.stdin
        assert served.stdout
        assert served.stderr
        while message := served.stdout.read(lock_step.SENSORS.size):
            said.update(message)
            served.stdin.write(pilot.answer(message))
            served.stdin.flush()
        told = served.stderr.read().decode()
    assert served.returncode == 0, told
    assert told.startswith(f"{seconds} s of simulated flight in ")
    return pilot, said.digest()


@pytest.mark.slow
@pytest.mark.parametrize("structure", stand_in.STRUCTURES)
def test_a_stand_in_flies_the_circle_by_each_control_structure(structure):
    pilot, _ = flown(structure, 6)
    assert len(pilot.path) == 6_000
    assert pilot.error() < 0.1


@pytest.mark.slow
def test_a_flight_of_a_stand_in_is_the_same_to_the_bit_each_time():
    assert flown("position", 2)[1] == flown("position", 2)[1]


def test_the_layout_is_that_of_the_documentation():
    assert lock_step.SENSORS.size == 76
    assert lock_step.MOTORS.size == struct.calcsize("<I4H") == 12
