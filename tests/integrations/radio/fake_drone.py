"""A Crazyflie that is not there: it speaks the real protocol over UDP on loopback, flies a
simulated drone, and misbehaves on demand.

It answers at once in a thread of its own what does not depend on time (tables, parameters, log
blocks). Its own time passes only in `advance`, so a test decides how fast: `Stepped` is a clock for
the program whose sleep lets that time pass and then waits until the program has every row. As a
program, `python tests/integrations/radio/fake_drone.py`, it flies in real time and prints its
address.

Source: cflib 0.1.34 (crtp, crazyflie: platformservice, toc, log, param, mem, supervisor,
commander).
"""

import bisect
import math
import random
import select
import socket
import struct
import sys
import threading
import time
import zlib
from typing import Any

from simple_physics import LEVEL, OFF, POSITION, STEP, Plant

from maidenflight.integrations.radio.blocks import LIMITS
from maidenflight.integrations.radio.crazyflie import Crazyflie

CONSOLE, PARAM, COMMANDER, MEM, LOGGING, GENERIC, SUPERVISOR, PLATFORM, LINK = (
    0,
    2,
    3,
    4,
    5,
    7,
    9,
    13,
    15,
)
PROTOCOL = 12
LEVELS_AFTER, STOPS_AFTER = 0.5, 2.0
FORMATS = {1: "<B", 2: "<H", 3: "<L", 4: "<b", 5: "<h", 6: "<i", 7: "<f", 8: "<e"}

STORED = {"uint8": 1, "uint16": 2, "int16": 5, "int32": 6, "float": 7}
LOG_TABLE = (
    [
        (f"stateEstimateZ.{name}", "int16")
        for name in ("x", "y", "z", "vx", "vy", "vz", "rateRoll", "ratePitch", "rateYaw")
    ]
    + [(f"stateEstimate.q{name}", "float") for name in "xyzw"]
    + [(f"motor.m{number}", "uint16") for number in (1, 2, 3, 4)]
    + [(f"ctrltarget.{name}", "float") for name in "xyz"]
    + [("controller.cmd_thrust", "float"), ("pm.vbatMV", "uint16"), ("supervisor.info", "uint16")]
    + [(f"kalman.varP{name}", "float") for name in "XYZ"]
    + [("pm.state", "uint8"), ("health.motorPass", "uint8")]
)
UINT8, UINT16, UINT32, FLOAT = 0x08, 0x09, 0x0A, 0x06
PACKED = {UINT8: "<B", UINT16: "<H", UINT32: "<L", FLOAT: "<f"}
KINDS = {"mf.hash": UINT32, "firmware.revision0": UINT32, "firmware.revision1": UINT16}
KINDS |= {f"cpu.id{number}": UINT32 for number in range(3)}
KINDS |= dict.fromkeys(("mf.x", "mf.y", "mf.full", *LIMITS), FLOAT)


def _force(motor_volts):
    """Thrust of a motor [N]: the law of the 2.1+ propellers. Source: firmware 2026.08, platform
    defaults."""
    return -0.024765379 + motor_volts * (
        0.065237935 + motor_volts * (-0.026792505 + motor_volts * 0.006776789)
    )


_FINENESS = 1e-4
_FORCES = [_force(number * _FINENESS) for number in range(40_000)]


def volts(share):
    """Motor voltage at a share of full thrust, 0.12 N."""
    return bisect.bisect(_FORCES, share * 0.12) * _FINENESS if share > 0 else 0.0


class FakeDrone:
    """Everything under `_lock`; the thread answers, `advance` lets time pass."""

    def __init__(
        self,
        seed=0,
        deck=True,
        policy=False,
        auto_armed=False,
        battery=4.0,
        settles=True,
        stamp=16_770_000,
    ):
        self.plant, self.random = Plant(seed), random.Random(seed)
        self.time, self._stamp, self.battery, self._settles = 0.0, stamp, battery, settles
        self.armed, self.auto_armed, self.tumbled, self.locked = False, auto_armed, False, False
        self.lost_rows, self.lost_commands, self.spoiled, self.leap, self.copies = (
            0.0,
            0.0,
            (),
            0.0,
            1,
        )
        self.tilt, self.refuses = 0.0, False
        self.why = 0
        self.active, self.policy_stiffness, self.late, self._held = 0, 1.4, 0, []
        self.motions = []
        self.faults, self.off_at, self.sent, self.heard, self.said = [], 0.0, [], [], []
        self.parameters = {"deck.bcFlow2": int(deck), "kalman.resetEstimation": 0} | (
            {"mf.enable": 0, "mf.task": 1, "mf.x": 9.0, "mf.y": 9.0, "mf.full": 60000.0}
            | dict.fromkeys(LIMITS, 9999.0)
            | {"mf.hash": 0xDEADBEEF, "mf.propellers": 0}
            if policy
            else {}
        )
        self.parameters |= {"cpu.id0": 0x12, "cpu.id1": 0xAB, "cpu.id2": 0xFFFFFFFF}
        self.parameters |= {"firmware.revision0": 0x2A18FC29, "firmware.revision1": 0x9D7B}
        self.parameters |= {"health.startPropTest": 0}
        self.charge, self.unbalanced, self.spun_at, self.deaf = 0, 0, math.inf, ()
        self.log_table = (
            [*LOG_TABLE, ("mf.active", "uint8"), ("mf.why", "uint8")] if policy else LOG_TABLE
        )
        self._blocks, self._running, self._client, self._last, self._settled_at = (
            {},
            {},
            None,
            0.0,
            0.0,
        )
        self._told, self._begun = (math.nan, {}), False
        self._lock = threading.RLock()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self.uri = f"udp://127.0.0.1:{self._socket.getsockname()[1]}"
        self._open = True
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.vanish()
        self._thread.join(timeout=5)

    def vanish(self):
        """Power off: the motors stop, and nobody answers any more."""
        with self._lock:
            if self._open:
                self._open = False
                self._socket.close()
            self.plant.mode = OFF
            self._blocks, self._running = {}, {}

    @property
    def down(self):
        """Whether the motors are off or the drone stands on the ground."""
        return not self.plant.turning or self.plant.position[2] <= 0.0

    def at(self, seconds, misbehave):
        """Lets something happen once its time has come."""
        self.faults.append((seconds, misbehave))

    # ---- time

    def advance(self, seconds):
        """Lets simulated time pass; rows are sent as they fall due."""
        with self._lock:
            self._drain()
            # How long it takes to connect is the computer's matter, and must not change the flight.
            self._begun = self._begun or len(self._running) == 3
            for _ in range(round(seconds / STEP) if self._begun else 0):
                self._tick()

    def _tick(self):
        self.time += STEP
        while self.faults and self.time >= self.faults[0][0]:
            self.faults.pop(0)[1](self)
        waited = self.time - self._last
        if self.plant.mode == POSITION and waited > LEVELS_AFTER:
            self.plant.mode = LEVEL
        if self.tumbled or self.locked or not self.armed or waited > STOPS_AFTER:
            self.plant.mode = OFF
        tilt = max(map(abs, self.plant.attitude[:2]))
        if self.parameters.get("mf.enable") == 0 or tilt > math.radians(30):
            self.active, self.why = 0, 2
        self.plant.stiffness = self.policy_stiffness if self.active else 1.0
        was = self.plant.turning
        self.plant.step()
        if was and not self.plant.turning:
            self.off_at = self.time
        if self.auto_armed:
            self.armed = True
        now = round(self.time / STEP)
        for number, (began, period) in list(self._running.items()):
            if now > began and (now - began) % period == 0:
                self._log(number)

    def _log(self, number):
        values = self._values()
        body = b"".join(
            struct.pack(FORMATS[kind], self._fit(kind, values[name]))
            for name, kind in self._blocks[number]
        )
        stamp = (self._stamp + round(self.time * 1000)) % (1 << 24)
        packet = bytes([LOGGING << 4 | 2, number]) + struct.pack("<I", stamp)[:3] + body
        if self.random.random() < self.lost_rows:
            return
        self._held.append((number, stamp, packet))
        if len(self._held) > self.late:
            # The newest first: a radio that sends again can turn the order round.
            for entry in reversed(self._held):
                for _ in range(self.copies):
                    if self._send(entry[2]):
                        self.sent.append(entry[:2])
            self._held.clear()

    @staticmethod
    def _fit(kind, value):
        if kind in (7, 8):
            return value
        low, high = {
            1: (0, 255),
            2: (0, 65535),
            3: (0, 2**32 - 1),
            4: (-128, 127),
            5: (-32768, 32767),
            6: (-(2**31), 2**31 - 1),
        }[kind]
        return min(max(round(value), low), high)

    def _values(self):
        if self._told[0] != self.time:
            self._told = self.time, self._measured()
        return (
            self._told[1]
            | {"mf.active": self.active, "mf.why": self.why}
            | dict.fromkeys(self.spoiled, math.nan)
        )

    def _measured(self):
        plant, noise = self.plant, self.random.gauss
        flying = plant.turning
        place = [p + noise(0, 0.001) for p in plant.position]
        place[0] += self.leap
        speed = [v + noise(0, 0.01) for v in plant.velocity]
        quaternion = [q + noise(0, 0.0005) for q in plant.quaternion]
        if self.tilt:
            quaternion = [math.sin(self.tilt / 2), 0.0, 0.0, math.cos(self.tilt / 2)]
        rates = [r + noise(0, 0.02) for r in plant.rates]
        load = sum(plant.command) / 4
        battery = self.battery - 0.4 * load
        values = {
            f"stateEstimateZ.{name}": 1000 * v
            for name, v in zip(("x", "y", "z", "vx", "vy", "vz"), place + speed, strict=True)
        }
        values |= {
            "stateEstimateZ.rateRoll": 1000 * rates[0],
            "stateEstimateZ.ratePitch": -1000 * rates[1],
        }
        values |= {"stateEstimateZ.rateYaw": 1000 * rates[2]}
        values |= {f"stateEstimate.q{name}": q for name, q in zip("xyzw", quaternion, strict=True)}
        values |= {
            f"motor.m{n + 1}": 65535 * min(volts(u) / battery, 1.0)
            for n, u in enumerate(plant.command)
        }
        values |= {f"ctrltarget.{name}": plant.setpoint[n] for n, name in enumerate("xyz")}
        info = (
            1
            | self.armed << 1
            | self.auto_armed << 2
            | (self.armed and not self.tumbled) << 3
            | flying << 4
        )
        info |= self.tumbled << 5 | self.locked << 6
        values |= {
            "controller.cmd_thrust": 65535 * load,
            "pm.vbatMV": 1000 * battery,
            "supervisor.info": info,
        }
        spun = 0 if self.time < self.spun_at + 4.0 else 0x8F & ~self.unbalanced
        values |= {"pm.state": self.charge, "health.motorPass": spun}
        waited = self.time - self._settled_at
        values |= {
            f"kalman.varP{name}": (math.exp(-5 * waited) if self._settles else noise(1, 0.1))
            for name in "XYZ"
        }
        return values

    # ---- protocol

    def _serve(self):
        while self._open:
            try:
                ready = select.select([self._socket], [], [], 0.02)[0]
                with self._lock:
                    if ready and self._open:
                        self._drain()
                    # As a real link does, and so the other side's threads never wait long.
                    self._send(bytes([0xFF]))
            except (OSError, ValueError):
                return

    def _drain(self):
        while self._open:
            try:
                packet, self._client = self._socket.recvfrom(64)
            except OSError:
                return
            port, channel, data = packet[0] >> 4, packet[0] & 3, packet[1:]
            if (
                port in (COMMANDER, GENERIC, SUPERVISOR)
                and self.random.random() < self.lost_commands
            ):
                continue
            if port == PARAM and self.lost_commands >= 1:
                continue
            self.heard.append((port, channel, bytes(data)))
            answer = {
                LINK: self._on_link,
                PLATFORM: self._on_platform,
                LOGGING: self._on_log,
                PARAM: self._on_parameter,
                MEM: lambda channel, data: (
                    bytes([1, 0]) if channel == 0 and data[:1] == b"\x01" else None
                ),
                SUPERVISOR: self._on_supervisor,
                GENERIC: self._on_setpoint,
            }.get(port, lambda channel, data: None)(channel, data)
            if answer is not None:
                self._send(bytes([packet[0]]) + answer)

    def _send(self, packet):
        if self._client is None or not self._open:
            return False
        try:
            self._socket.sendto(packet, self._client)
        except OSError:
            return False
        return True

    def _on_link(self, channel, data):
        if channel == 0:
            return data
        return b"Bitcraze Crazyflie\0" if channel == 1 else None

    def _on_platform(self, channel, data):
        return bytes([0, PROTOCOL]) if channel == 1 and data[0] == 0 else None

    def _toc(self, data, entries):
        if data[0] == 3:
            return bytes([3]) + struct.pack("<HI", len(entries), zlib.crc32(repr(entries).encode()))
        number = struct.unpack("<H", data[1:3])[0]
        name, kind = entries[number]
        return data[:3] + bytes([kind]) + name.replace(".", "\0").encode() + b"\0"

    def _on_log(self, channel, data):
        if channel == 0:
            return self._toc(data, [(name, STORED[kind]) for name, kind in self.log_table])
        command, number = data[0], data[1] if len(data) > 1 else 0
        if command == 5:
            self._blocks, self._running = {}, {}
        elif command in (6, 7):
            entries = [
                struct.unpack("<BH", data[2 + at : 5 + at])
                for at in range(0, (len(data) - 2) // 3 * 3, 3)
            ]
            added = [(self.log_table[entry][0], kind & 15) for kind, entry in entries]
            self._blocks[number] = (self._blocks.get(number, []) if command == 7 else []) + added
            if sum(struct.calcsize(FORMATS[kind]) for _, kind in self._blocks[number]) > 26:
                return bytes([command, number, 7])
        elif command == 3 and number in self._blocks:
            # A block's timer starts at an instant of its own.
            self._running[number] = (
                round(self.time / STEP) + self.random.randrange(5),
                round(data[2] * 0.01 / STEP),
            )
        elif command == 4:
            self._running.pop(number, None)
        else:
            return bytes([command, number, 2])
        return bytes([command, number, 0])

    def _on_parameter(self, channel, data):
        names = list(self.parameters)
        if channel == 0:
            return self._toc(data, [(name, self._kind(name)) for name in names])
        if channel == 1:
            name = names[struct.unpack("<H", data[:2])[0]]
            return data[:2] + b"\0" + struct.pack(PACKED[self._kind(name)], self.parameters[name])
        if channel == 3 and data[0] == 0:
            group, name, rest = data[1:].split(b"\0", 2)
            self._set(f"{group.decode()}.{name.decode()}", rest[0], rest[1:])
            return data[: -len(rest)] + b"\0"
        return None

    @staticmethod
    def _kind(name):
        return KINDS.get(name, UINT8)

    def _set(self, name, kind, content):
        assert name in self.parameters
        assert kind == self._kind(name)
        (value,) = struct.unpack(PACKED[kind], content)
        if name in self.deaf:
            return
        self.parameters[name] = value
        if name == "health.startPropTest" and value:
            self.spun_at = self.time
        if name == "kalman.resetEstimation" and value:
            self._settled_at = self.time
        if name == "mf.enable" and value:
            self.active = 1

    def _on_supervisor(self, channel, data):
        if channel == 1 and data[0] == 1:
            self.armed = bool(data[1]) and not (self.locked or self.tumbled or self.refuses)
            return bytes([0x81, 1, self.armed])
        return None

    def _on_setpoint(self, channel, data):
        if channel == 0 and data[0] == 0:
            self.plant.mode = OFF
        elif channel == 0 and data[0] in (6, 7):
            if data[0] == 7:
                x, y, z, yaw = struct.unpack("<ffff", data[1:17])
            else:  # in mm; the turn that follows is upright at zero
                (x, y, z, *motion), yaw = (v / 1000 for v in struct.unpack("<9h", data[1:19])), 0.0
                self.motions.append(motion)
            self.plant.setpoint, self.plant.mode, self._last = (
                (x, y, z, math.radians(yaw)),
                POSITION,
                self.time,
            )


class Stepped:
    """A clock for the program under test: to sleep is to let the fake drone's time pass, then to
    wait for its rows to arrive."""

    def __init__(self, fake):
        self.fake, self.time, self.before = fake, 100.0, []
        self.link: Any = None
        self._early = 0

    def now(self):
        return self.time

    def sleep(self, seconds):
        for misbehave in list(self.before):
            misbehave(self)
        rest = seconds
        while rest > 1e-9:
            # More at a time would overflow the socket.
            part = min(rest, 0.1)
            self.time += part
            rest -= part
            self.fake.advance(part)
            self._arrived()

    def _arrived(self):
        until = time.monotonic() + 30
        while (
            self.link is not None
            and not self.link.lost
            and self.link.received < len(self.fake.sent)
        ):
            assert time.monotonic() < until, (
                f"{self.link.received} of {len(self.fake.sent)} rows arrived"
            )
            time.sleep(2e-5)
        if self.link is None or not self.link.received:
            # Nothing to wait for yet: the first order to send rows takes its own, real time.
            self._early += 1
            time.sleep(0.002 if self._early < 50 else 0.05)

    def connect(self):
        """The program's connection to the fake drone, of whose rows this clock knows from the
        first."""
        clock = self

        class Watched(Crazyflie):
            lost, received = "", 0

            def __init__(self, *given, **named):
                clock.link = self
                super().__init__(*given, **named)

        return Watched(self.fake.uri, self)


def main(seconds=600.0):
    """Flies in real time until the time is over."""
    with FakeDrone(policy="policy" in sys.argv[1:]) as fake:
        print(fake.uri, flush=True)
        began = time.monotonic()
        while (now := time.monotonic() - began) < seconds:
            time.sleep(0.002)
            fake.advance(max(round((now - fake.time) / STEP), 0) * STEP)


if __name__ == "__main__":
    main()
