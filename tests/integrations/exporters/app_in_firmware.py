"""The exported app built for this computer, in the stand-in firmware, and how to call it."""

import ctypes
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

from maidenflight.integrations.exporters.crazyflie_app import export_crazyflie
from maidenflight.policy import Policy
from maidenflight.simulator.controllers import firmware

HERE = Path(__file__).parent / "crazyflie"
STRICT = (
    "-Os",
    "-Wall",
    "-Wextra",
    "-Werror",
    "-std=gnu11",
    "-Wdouble-promotion",
    "-Wmissing-prototypes",
)
COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]
ABSOLUTE, VELOCITY = firmware.ABSOLUTE, firmware.VELOCITY
LEGACY, FORCE_TORQUE, FORCE = 0, 1, 2
HOVER_THRUST = 35_000.0
START = (0.5, -0.25)
GIVEN = np.dtype(
    [
        ("position", "f4", 3),
        ("quaternion", "f4", 4),
        ("velocity", "f4", 3),
        ("gyro", "f4", 3),
        ("wanted", "f4", 3),
        ("thrust", "f4"),
        ("modes", "i4", 7),
        ("acceleration", "f4", 3),
        ("battery", "f4"),
        ("wanted_velocity", "f4", 3),
        ("wanted_acceleration", "f4", 3),
    ]
)
ASKED = np.dtype(
    [("attitude", "f4", 3), ("rate", "f4", 3), ("thrust", "f4"), ("modes", "i4", 7), ("step", "u4")]
)
FOUND = np.dtype(
    [
        ("forces", "f4", 4),
        ("torque", "f4", 3),
        ("thrust", "f4"),
        ("mode", "i4"),
        ("calls", "i4"),
        ("asked", ASKED, 4),
    ]
)


class Entry(ctypes.Structure):
    """A row of a table of parameters or of log variables."""

    _fields_ = [("name", ctypes.c_char_p), ("type", ctypes.c_int), ("address", ctypes.c_void_p)]


READ_ONLY = 64
"""What a parameter's type has more where only the app writes it."""
KINDS = {
    "params_mf": (ctypes.c_uint8, ctypes.c_uint16, ctypes.c_float, ctypes.c_uint32),
    "logs_mf": (ctypes.c_uint8, ctypes.c_uint32, ctypes.c_float),
}


class App:
    """The app, switched on."""

    def __init__(self, library: Path) -> None:
        """Loads a library that no other app has loaded, since all of the app's memory is in it."""
        self.library, self.step = ctypes.CDLL(str(library)), 1
        self.library.controllerOutOfTreeTest.restype = ctypes.c_bool
        self.tables = {}
        for table, kinds in KINDS.items():
            rows = (Entry * 64).in_dll(self.library, table)
            count = next(number for number, row in enumerate(rows) if row.name is None)
            self.tables[table] = {
                row.name.decode(): kinds[row.type % READ_ONLY].from_address(row.address)
                for row in rows[:count]
            }
        rows = (Entry * 64).in_dll(self.library, "params_mf")
        named = rows[: len(self.tables["params_mf"])]
        self.read_only = {row.name.decode() for row in named if row.type >= READ_ONLY}
        self.parameters, self.logs = self.tables.values()
        self.library.controllerOutOfTreeInit()

    def test(self) -> bool:
        return self.library.controllerOutOfTreeTest()

    def set(self, **values: float) -> None:
        for name, value in values.items():
            self.parameters[name].value = value

    def log(self, name: str) -> float:
        return self.logs[name].value

    def fly(self, given: np.ndarray) -> np.ndarray:
        """A millisecond for each row."""
        given, found = np.ascontiguousarray(given), np.zeros(len(given), FOUND)
        places = (rows.ctypes.data_as(ctypes.c_void_p) for rows in (given, found))
        self.library.fly(ctypes.c_uint32(self.step), len(given), *places)
        self.step += len(given)
        return found

    def hover(self, milliseconds: int = 1, **changes: Any) -> np.ndarray:
        return self.fly(hovering(milliseconds, **changes))

    def run_app(self) -> int:
        """Runs the app's own task up to its next delay; how long that is [ms]."""
        return self.library.run_app()

    def until(self, step: int) -> None:
        """Hovers until a step is next."""
        self.hover(step - self.step)

    def enable(self, **values: float) -> None:
        """Sets parameters, hovers for a second by the PID and lets the policy fly."""
        self.set(**values)
        self.until(1000)
        self.set(enable=1)


def hovering(milliseconds: int, **changes: Any) -> np.ndarray:
    """At rest at the circle's start, which the commander asks for."""
    given = np.zeros(milliseconds, GIVEN)
    given["position"] = given["wanted"] = (*START, 1.0)
    given["quaternion"] = (0, 0, 0, 1)
    given["thrust"] = HOVER_THRUST
    given["battery"] = 4.0
    given["modes"] = (ABSOLUTE, ABSOLUTE, ABSOLUTE, 0, 0, ABSOLUTE, 0)
    for name, value in changes.items():
        given[name] = value
    return given


def built(policy: Policy, folder: Path, **options: Any) -> Path:
    """The app by the Makefile beside the stand-in firmware, as a library with the harness."""
    export_crazyflie(policy, folder, **options)
    made = make(folder, COMPILERS[0], "-fPIC")
    assert (made.returncode, made.stderr) == (0, "")
    objects = [folder / "build/maidenflight.o", folder / "build/policy.o"]
    flags = (*STRICT, "-fPIC", "-shared", f"-I{HERE / 'firmware'}")
    library = folder / "app.so"
    command = [COMPILERS[0], *flags, HERE / "harness.c", *objects, "-o", library, "-lm"]
    subprocess.run(command, check=True)
    return library


def make(
    folder: Path, compiler: str, *flags: str, base: Path = HERE / "firmware"
) -> subprocess.CompletedProcess[str]:
    settings = {"CRAZYFLIE_BASE": str(base), "CC": compiler, "CFLAGS": " ".join((*STRICT, *flags))}
    told = [f"{name}={value}" for name, value in settings.items()]
    # A folder elsewhere, as PWD would tell it.
    return subprocess.run(
        ["make", "-s", "-C", folder, *told],
        capture_output=True,
        text=True,
        env={**os.environ, "PWD": "/"},
        cwd="/",
    )
