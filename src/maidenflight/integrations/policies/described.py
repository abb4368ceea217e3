"""`DescribedPolicy`, a network by others, and the TOML file that says what its numbers are.

```toml
network = "policy.onnx"  # beside the TOML file; or "model.zip" of Stable-Baselines3
rate = 100               # actions a second [Hz]
inputs = ["position_error", "rotation_matrix", "velocity_error", "body_rates", "last_action"]
range = [-1, 1]          # of the four outputs, from motors off to full
commands = "rotor_speed" # or "thrust", its square
motors = [1, 2, 3, 4]    # the motor of each output: front right, back right, back left, front left
```

`history` (1 by default) joins so many instants, the oldest first; `mean` and `std` scale one
instant; `look_ahead = {points = 5, spacing = 0.1}` puts so many points of the reference to come, so
many seconds apart and relative to the position, behind the newest instant; `output` names the
output of an ONNX file that commands the motors, the first one by default. What commands the
motors is what the next instant holds as `last_action`, not clipped. Of a `model.zip`, `range` is
that of its action space by default, and `normalization` names the file of its `VecNormalize`.
"""

from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from maidenflight import inputs
from maidenflight.errors import InputError
from maidenflight.flying.foreign_policy import reference_velocity
from maidenflight.flying.pilots import Fly
from maidenflight.inputs import StrPath
from maidenflight.integrations.policies import onnx_file, stable_baselines
from maidenflight.integrations.policies.onnx_file import Network
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.policy_spec import PolicySpec, points_at
from maidenflight.simulator.tasks.tasks import Task


class Instant(NamedTuple):
    """What is known when an action is due."""

    position: Float[np.ndarray, "3"]
    velocity: Float[np.ndarray, "3"]
    quaternion: Float[np.ndarray, "4"]
    body_rates: Float[np.ndarray, "3"]
    setpoint: Float[np.ndarray, "3"]
    setpoint_velocity: Float[np.ndarray, "3"]
    last_action: Float[np.ndarray, "4"]

    @property
    def turned(self) -> Rotation:
        """Body to world."""
        return Rotation.from_quat(self.quaternion)


INPUTS: Mapping[str, Callable[[Instant], Any]] = {
    "position": lambda now: now.position,
    "position_error": lambda now: now.position - now.setpoint,
    "setpoint_offset": lambda now: now.setpoint - now.position,
    "velocity": lambda now: now.velocity,
    "velocity_error": lambda now: now.velocity - now.setpoint_velocity,
    "setpoint_velocity": lambda now: now.setpoint_velocity,
    "body_velocity": lambda now: now.turned.inv().apply(now.velocity),
    "rotation_matrix": lambda now: now.turned.as_matrix().ravel(),
    "quaternion_xyzw": lambda now: now.quaternion,
    "quaternion_wxyz": lambda now: np.roll(now.quaternion, 1),
    "roll_pitch_yaw": lambda now: now.turned.as_euler("ZYX")[::-1],
    "body_rates": lambda now: now.body_rates,
    "last_action": lambda now: now.last_action,
}
"""What an input may be, SI units, world z up, body x forward and y left; `rotation_matrix` row by
row."""
OBSERVED = PolicySpec.OBSERVED
_NEEDED = {"network", "rate", "inputs", "range", "commands"}
_KEYS = {*_NEEDED, "motors", "mean", "std", "output", "normalization", *OBSERVED}


class DescribedPolicy:
    """A network and what its numbers are; follows the `ForeignPolicy` protocol."""

    def __init__(
        self, name: str, place: str, description: Mapping[str, Any], network: Network
    ) -> None:
        """Puts them together."""
        self.name, self._place = name, place
        self.rate = self.command_rate = description["rate"]
        self._parts = [INPUTS[name] for name in description["inputs"]]
        self._lowest, self._highest = description["range"]
        self._power = 2 if description["commands"] == "rotor_speed" else 1
        self._motors = np.array(description["motors"]) - 1
        self._mean, self._std = description["mean"], description["std"]
        self._spec: PolicySpec = description["spec"]
        self._network = network

    def begin(self, hover: float, task: Task) -> Fly:
        """Begins a flight; its last action is that of hover."""
        velocity_at, calls = reference_velocity(task), 0
        span = self._highest - self._lowest
        last = np.full(4, self._lowest + span * hover ** (1 / self._power))
        past: deque[np.ndarray] = deque(maxlen=self._spec.history)

        def fly(
            measurement: Measurement, setpoint: Float[np.ndarray, "3"]
        ) -> Float[np.ndarray, "4"]:
            nonlocal last, calls
            values = [np.asarray(part, np.float64) for part in measurement]
            now = Instant._make([*values, setpoint, velocity_at(calls / self.rate), last])
            instant = (np.concatenate([part(now) for part in self._parts]) - self._mean) / self._std
            past.extend([instant] * (1 if past else self._spec.history))
            points = np.asarray(points_at(self._spec, task.reference, calls / self.rate))
            last = self._run(np.concatenate([*past, np.ravel(points - now.position)]))
            calls += 1
            command = np.empty(4)
            command[self._motors] = (last - self._lowest) / span
            return np.clip(command, 0.0, 1.0) ** self._power

        return fly

    def _run(self, numbers: np.ndarray) -> np.ndarray:
        """The four outputs."""
        try:
            output_values = self._network(numbers)
        except ValueError as error:
            raise InputError(
                f"{self._place}: the network takes no {len(numbers)} inputs "
                f"({str(error).splitlines()[0]:.120}). Check inputs, history and look_ahead."
            ) from error
        output = np.ravel(output_values).astype(np.float64)
        if output.shape != (4,) or not np.isfinite(output).all():
            raise InputError(f"{self._place}: outputs {output}; expected four finite numbers.")
        return output


def described(path: StrPath) -> DescribedPolicy:
    """Returns the policy that a TOML file describes.

    Raises:
        InputError: a package is not installed, or the files do not fit each other.
    """
    description = _read(path)
    file = Path(path).parent / str(description["network"])
    if file.suffix != ".zip":
        description = complete_description(path, description)
        network = onnx_file.network(file, description["output"], str(path))
    else:
        scaled = description.get("normalization")
        scaling = None if scaled is None else file.parent / str(scaled)
        model = stable_baselines.read_model(file, scaling)
        description = complete_description(path, {"range": list(model.range)} | description)
        network = model.act
    return DescribedPolicy(Path(path).stem, str(path), description, network)


def of_own_environment(path: StrPath) -> DescribedPolicy:
    """Returns a policy of Stable-Baselines3 that our environments trained, by its file alone.

    The file `vecnormalize.pkl` beside it is its scaling of observations where it is there; tables
    then call the policy by both names.

    Args:
        path: `model.zip`.

    Raises:
        InputError: a package is not installed, or the file is another environment's.
    """
    scaling = Path(path).parent / stable_baselines.SCALING
    model = stable_baselines.read_model(path, scaling if scaling.is_file() else None)
    name = Path(path).stem + (f"+{scaling.stem}" if scaling.is_file() else "")
    content = {"network": Path(path).name, **stable_baselines.layout(path, model)}
    description = complete_description(path, content)
    return DescribedPolicy(name, str(path), description, model.act)


def _read(path: StrPath) -> dict[str, Any]:
    """What a file says, checked."""
    content = inputs.toml_file(path, "a policy's TOML file", "Mend it.")
    if "network" not in content:
        raise InputError(f"{path}: network is lacking; expected the name of a file beside it.")
    return content


def complete_description(path: StrPath, content: Mapping[str, Any]) -> dict[str, Any]:
    """Returns what a description says, with what is usual where it says nothing.

    Raises:
        InputError: something is lacking or unknown, or a value makes no sense.
    """
    zipped = str(content["network"]).endswith(".zip")
    known_keys = _KEYS - {"output"} if zipped else _KEYS - {"normalization"}
    lacking = _NEEDED - content.keys()
    if lacking or content.keys() - known_keys:
        raise InputError(
            f"{path}: {', '.join(sorted(lacking)) or 'nothing'} is lacking and "
            f"{', '.join(sorted(content.keys() - known_keys)) or 'nothing'} is unknown; expected "
            f"network, rate, inputs, range, commands, and perhaps motors, {', '.join(OBSERVED)}, "
            f"mean, std, {'normalization' if zipped else 'output'}."
        )
    usual: Any = {"motors": [1, 2, 3, 4], "history": 1, "output": None}
    description: dict[str, Any] = {**usual, **content}
    for name in ("inputs", "range", "motors", "mean", "std"):
        if name in description and not (isinstance(description[name], list) and description[name]):
            raise InputError(f"{path}: {name} = {description[name]!r}; expected a list.")
    known = [INPUTS[name](_EXAMPLE) for name in description["inputs"] if name in INPUTS]
    unknown = [name for name in description["inputs"] if name not in INPUTS]
    size = sum(map(len, known))
    description = {"mean": [0.0] * size, "std": [1.0] * size} | description
    mean, std = description["mean"], description["std"]
    wrong = {
        f"inputs {unknown}, of {', '.join(INPUTS)}": bool(unknown),
        "rate, a divisor of 500": not _whole(description["rate"]) or 500 % description["rate"] != 0,
        "range, two growing numbers": not _growing(description["range"]),
        "commands, thrust or rotor_speed": description["commands"] not in ("thrust", "rotor_speed"),
        "motors, 1 to 4 in any order": sorted(map(str, description["motors"])) != list("1234"),
        f"mean and std, {size} numbers": {len(mean), len(std)} != {size},
        "mean, numbers": not all(map(inputs.is_number, mean)),
        "std, positive numbers": not all(inputs.is_number(one) and one > 0 for one in std),
    }
    if problems := [problem for problem, is_wrong in wrong.items() if is_wrong]:
        raise InputError(f"{path}: expected {'; '.join(problems)}.")
    observed = {name: description[name] for name in OBSERVED if name in description}
    try:
        spec = PolicySpec.from_dict(observed)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return description | {"mean": np.array(mean), "std": np.array(std), "spec": spec}


_EXAMPLE = Instant._make(
    [*np.zeros((2, 3)), np.array([0.0, 0.0, 0.0, 1.0]), *np.zeros((3, 3)), np.zeros(4)]
)


def _whole(value: Any) -> bool:
    return type(value) is int and value > 0


def _growing(value: Any) -> bool:
    return len(value) == 2 and all(map(inputs.is_number, value)) and value[0] < value[1]
