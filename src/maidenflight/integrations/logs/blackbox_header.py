"""What the header of a Betaflight blackbox log says, and in which units.

Source: Betaflight 3.1 to 4.5, src/main/blackbox/blackbox.c (blackboxWriteSysinfo), flight/mixer.h
(mixerMode), config/feature.h; src/main/sensors/acceleration.c, gyro.c; common/filter.c.
"""

import re
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from maidenflight import budget, inputs
from maidenflight.errors import InputError
from maidenflight.flights.streams import rates

_MOST_INTERVAL = 4096
"""Frames between two whole ones that a sound header may have."""
_MIXERS = {
    **{1: "tricopter", 2: "quadrotor in +", 4: "bicopter", 5: "gimbal", 6: "Y6", 7: "hexarotor"},
    **{8: "flying wing", 9: "Y4", 10: "hexarotor", 11: "octorotor", 12: "octorotor"},
    **{13: "octorotor", 14: "airplane", 15: "helicopter", 16: "helicopter", 17: "V-tail quadrotor"},
    **{18: "hexarotor", 20: "dualcopter", 21: "singlecopter", 22: "A-tail quadrotor"},
    **{23: "custom mixer", 24: "custom airplane", 25: "custom tricopter", 26: "QUADX_1234"},
}
"""Airframes by Betaflight's mixerMode (mixer.h), but 3, which is a quadrotor in X."""
_FEATURE_3D = 1 << 12  # config/feature.h
_FIELDS = re.compile(rb"H Field [^\n]*")


def check_fields(path: Path) -> None:
    """Refuses headers of more fields than firmwares log: the decoder takes their square.

    Raises:
        ValueError, OSError: one has, or the file cannot be read.
    """
    raw = inputs.content(path, budget.WHOLE_LOG)
    longest = max((line.group().count(b",") for line in _FIELDS.finditer(raw)), default=0)
    budget.WHOLE_LOG.check("fields", longest)


def check_airframe(name: str, headers: Mapping[str, Any]) -> None:
    """Refuses firmware with other conventions, other airframes and motors that turn both ways.

    Raises:
        InputError: what it is.
    """
    firmware = " ".join(str(headers.get(key, "")) for key in ("Firmware type", "Firmware revision"))
    if "inav" in firmware.lower():
        raise InputError(
            f"{name}: a log of INAV ({headers.get('Firmware revision', 'version unknown')}), whose "
            "axes and motor outputs are other than Betaflight's; expected a log of Betaflight."
        )
    keys = ("mixer", "mixerMode", "mixer_mode", "mixer_type", "mixerConfiguration")
    mixer = next((headers[key] for key in keys if key in headers), 3)
    mixer_name = _MIXERS.get(mixer) if isinstance(mixer, int) else str(mixer)
    is_x = mixer == 3 or str(mixer_name).strip().lower() in ("quadx", "quad x", "0")
    if mixer_name is not None and not is_x:
        raise InputError(
            f"{name}: its mixer is of another airframe ({mixer_name}); expected a quadrotor in X."
        )
    features = headers.get("features")
    if isinstance(features, int) and features & _FEATURE_3D:
        raise InputError(
            f"{name}: logged in 3D mode, in which motors turn both ways; expected motors that turn "
            "one way. Fly without the feature 3D."
        )


def check_intervals(name: str, headers: Mapping[str, Any]) -> None:
    """Refuses intervals of frames with which the decoder would never come to an end."""
    whole, between = headers.get("I interval", 1), str(headers.get("P interval", "1/1"))
    shares = [part for part in between.split("/") if part.isdecimal()]
    sound = isinstance(whole, int) and 0 < whole <= _MOST_INTERVAL
    sound &= len(shares) == between.count("/") + 1 and len(shares) <= 2
    sound &= all(int(share) <= _MOST_INTERVAL for share in shares)
    if not sound or (len(shares) == 2 and not int(shares[0])):
        raise InputError(
            f"{name}: not a readable blackbox log (I interval {whole!r}, P interval {between!r}). "
            "Copy it again."
        )


def number(headers: Mapping[str, Any], key: str, otherwise: float) -> float:
    """Returns a number of the header, or another one where it has none."""
    value = headers.get(key, otherwise)
    sound = isinstance(value, int | float) and abs(value) < 1e12
    return float(value) if sound else otherwise


def force_delay(headers: Mapping[str, Any]) -> float:
    """Returns the delay of the accelerometer's low-pass filter [s].

    Betaflight writes `acc_lpf_hz` times 100, at least from 3.1 to 4.5. It is a Butterworth, from
    4.3 on two lags of first order that pass 0.71 at the cutoff together, 1.554 times as quick each.
    """
    cutoff = number(headers, "acc_lpf_hz", 0.0) / 100.0
    if cutoff <= 0:
        return 0.0
    if "gyro_lpf1_static_hz" in headers:
        return 2.0 / (2 * np.pi * cutoff / np.sqrt(np.sqrt(2.0) - 1.0))
    return rates.filter_delay(cutoff)


def counts_of_1_g(
    name: str, counts: Float[np.ndarray, "N 3"], headers: Mapping[str, Any]
) -> tuple[float, list[str]]:
    """Counts of 1 g, by the header or by gravity, and a note on the latter.

    Raises:
        InputError: neither tells.
    """
    one_g = number(headers, "acc_1G", 0.0)
    if one_g > 0:
        return one_g, []
    size = float(np.median(np.linalg.norm(counts, axis=1)))
    if not 50.0 < size < 40000.0:
        raise InputError(
            f"{name}: its header says acc_1G {one_g:g}, and the accelerometer reads {size:g} counts"
            ": none was logged. Calibrate the accelerometer and log it."
        )
    # Sensors count a power of two a g.
    whole = 2.0 ** round(float(np.log2(size)))
    return whole, [
        f"{name}: its header says acc_1G {one_g:g}; gravity shows {size:.0f} counts a g, taken as "
        f"{whole:g}"
    ]


def gyro_scale(headers: Mapping[str, Any]) -> float:
    """Degrees a second of a count: of today's firmware 1, or 0.1 at high resolution."""
    scale, value = headers.get("gyro_scale"), 1.0
    if isinstance(scale, int):
        (value,) = struct.unpack("<f", struct.pack("<I", scale & 0xFFFFFFFF))
    value = value if 1e-3 <= value <= 10.0 else 1.0
    return value / (10.0 if headers.get("blackbox_high_resolution") == 1 else 1.0)


def gyro_delay(headers: Mapping[str, Any]) -> float:
    """Returns the delay of the static low-pass filters before the PID, 1 / (2 pi f) each [s]."""
    delay = 0.0
    for keys in (
        ("gyro_lpf1_static_hz", "gyro_lowpass_hz"),
        ("gyro_lpf2_static_hz", "gyro_lowpass2_hz"),
    ):
        cutoff = next((number(headers, key, 0.0) for key in keys if key in headers), 0.0)
        delay += 1 / (2 * np.pi * cutoff) if cutoff > 0 else 0.0
    return float(delay)
