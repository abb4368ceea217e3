"""Errors of what accelerometer and gyro measure, and their likelihood: no state is needed.

The specific force along z is the rotors' thrust and the drag against climbing, the change of the
body rates the rotors' torque. Both follow from the logged commands. Errors are an autoregression
over the last quarter of a second; `one_step` says why. An autoregression hardly weighs what lasts,
so two things are said apart: the mean force of each segment of flight, which is known within
`LEVEL`, and the constant torques, which make the mean errors of the body rates zero.

Source: Eschmann, Albani and Loianno 2024, Data-driven system identification of quadrotors subject
to motor delays (accelerometer and gyro against commands); Ljung 1999, System identification: theory
for the user, ch. 7 and 13.4 (prediction errors, closed loop).
"""

from collections.abc import Mapping, Sequence

import numpy as np
import scipy
from jaxtyping import Float
from numpy.lib.stride_tricks import sliding_window_view

from maidenflight.identification.gauss_newton import NormalEquations
from maidenflight.identification.inertial_signals import Rotors, Signals
from maidenflight.identification.one_step import BY_MOMENT, NoiseModel, noise_model
from maidenflight.identification.prediction_errors import MEMORY
from maidenflight.parameters import Parameters, component, levers, replace

LEVEL = 0.02 * 9.81
"""Standard deviation of a segment's mean specific force from the model's [m/s2]: battery, climb,
the sensor's scale."""
MOTORS = ("motor_time_constant", "spin_down_ratio", "motor_coasting", "latency")
"""Parameters on which the rotors' speeds depend."""
_NUDGES = {
    "latency": 1e-3,
    "motor_coasting": 5e-3,
    "thrust_offset": 1e-2,
    "thrust_linear": 1e-2,
    "drag_z": 1e-2,
    "torque_to_thrust": 1e-4,
    **dict.fromkeys((*BY_MOMENT, "rotor_momentum", "rotational_damping"), 1e-6),
}
"""Changes over which slopes are taken, SI units; a hundredth of the value unless given. All slopes
but the motors' are constant over them."""


class InertialErrors:
    """Minus the mean log likelihood of a step, with the noise model that fits best.

    It offers what `selection.choose` and `gauss_newton.descend` need of an objective.
    """

    def __init__(
        self,
        signals: Signals,
        priors: Mapping[str, tuple[float, float]] | None = None,
        white: bool = False,
    ):
        """Prepares what does not depend on the drone.

        Args:
            signals: of the accelerometer or the gyro.
            priors: mean and standard deviation of what is known beforehand, by parameter.
            white: whether errors are white noise, as in plain least squares.
        """
        self.signals, self.priors = signals, priors or {}
        self.order = 0 if white else round(MEMORY / signals.step)
        self.segments = len(signals.flights)
        self.rows_per_segment = signals.used.sum(axis=0).astype(float)
        self.rows = float(self.rows_per_segment.sum())
        self._latest: tuple[list[float], Rotors] | None = None

    def white(self) -> "InertialErrors":
        """The same with white noise."""
        return InertialErrors(self.signals, self.priors, white=True)

    def parted(self) -> "tuple[InertialErrors, InertialErrors] | None":
        """Segments to fit and others to judge by; see `Signals.parted`."""
        parts = self.signals.parted()
        if parts is None:
            return None
        return InertialErrors(parts[0], self.priors), InertialErrors(parts[1], self.priors)

    def _rotors(self, drone: Parameters) -> Rotors:
        """The rotors of a drone; those of the last one are kept, since many share their motors."""
        motors = [float(component(drone, name)) for name in MOTORS]
        if self._latest is None or self._latest[0] != motors:
            self._latest = motors, self.signals.rotors(drone)
        return self._latest[1]

    def _predicted(self, drone: Parameters, rotors: Rotors) -> Float[np.ndarray, "M S C"]:
        """What a drone with these rotors measures.

        Source: Gronauer et al. 2022, eq:motor-force, eq:torque, eq:motor-torque and
        eq:angular-acceleration, of means over a step.
        """
        offset, linear = float(drone.thrust_offset), float(drone.thrust_linear)
        share = offset + linear * rotors.mean + (1 - offset - linear) * rotors.square
        thrust = float(drone.gravity * drone.thrust_to_weight) / 4 * share
        arms, rates = levers(drone), self.signals.body_rates
        turned = arms * [1.0, 1.0, float(drone.torque_to_thrust)]
        inertia, bias = np.asarray(drone.inertia, float), np.asarray(drone.torque_bias, float)
        found = []
        for place in self.signals.sensor.places:
            if place == 0:
                drag = float(drone.drag[2]) * self.signals.climb
                found.append(thrust.sum(axis=-1) - drag)
                continue
            axis, one, other = place - 1, place % 3, (place + 1) % 3
            torque = bias[axis] + float(drone.mass) * (thrust @ turned[:, axis])
            if axis == 2:
                spin_up = rotors.change @ arms[:, axis] / self.signals.step
                torque += float(drone.rotor_momentum) * spin_up
            else:
                torque -= float(drone.rotational_damping) * rates[..., axis]
            torque -= (inertia[other] - inertia[one]) * rates[..., one] * rates[..., other]
            found.append(torque / inertia[axis])
        return np.stack(found, axis=-1)

    def errors(self, parameters: Parameters) -> Float[np.ndarray, "M S C"]:
        """Measured minus predicted, signal by signal."""
        return self.signals.measured - self._predicted(parameters, self._rotors(parameters))

    def noise_model(self, parameters: Parameters) -> NoiseModel:
        """The noise model that fits best (least squares)."""
        return noise_model(self._products(self.errors(parameters)) / self.rows)

    def _products(self, errors: Float[np.ndarray, "M S C"]) -> Float[np.ndarray, "C P+1 P+1"]:
        """Products of errors with themselves 0 ... P steps before, summed."""
        late = (self._late(errors[..., place]) for place in range(errors.shape[-1]))
        return np.stack([some.T @ some for some in late])

    def _late(self, errors: Float[np.ndarray, "M S"]) -> Float[np.ndarray, "T P+1"]:
        """Errors 0 ... P steps before each step that counts; zero where there are none."""
        padded = np.concatenate([np.zeros((self.order, errors.shape[1])), errors])
        return self._counted(sliding_window_view(padded, self.order + 1, axis=0)[..., ::-1])

    def _counted(self, values: Float[np.ndarray, "M S ..."]) -> Float[np.ndarray, "T ..."]:
        """The steps that count, segment after segment."""
        return np.swapaxes(values, 0, 1)[self.signals.used.T]

    def _means(self, values: Float[np.ndarray, "M S ..."]) -> Float[np.ndarray, "S ..."]:
        """Means over the steps of each segment that count."""
        return self._sums(self._counted(values)) / self.rows_per_segment.reshape(
            -1, *(1,) * (values.ndim - 2)
        )

    def _sums(self, counted: Float[np.ndarray, "T ..."]) -> Float[np.ndarray, "S ..."]:
        """Sums over the steps of each segment."""
        ends = np.cumsum(self.rows_per_segment).astype(int)
        return np.add.reduceat(counted, np.concatenate([[0], ends[:-1]]), axis=0)

    def __call__(self, parameters: Parameters) -> float:
        """Minus the mean log likelihood of a step."""
        return float(self.per_segment(parameters, self.noise_model(parameters)).sum() / self.rows)

    def per_segment(self, parameters: Parameters, noise: NoiseModel) -> Float[np.ndarray, "S"]:
        """Minus the log likelihood of each segment of flight under a given noise model."""
        return self._minus_log_likelihood(self.errors(parameters), noise)

    def _minus_log_likelihood(
        self, errors: Float[np.ndarray, "M S C"], noise: NoiseModel
    ) -> Float[np.ndarray, "S"]:
        constant = np.sum(np.log(noise.deviation) + 0.5 * np.log(2 * np.pi))
        new = self._counted(_whitened(errors, noise))
        found = self.rows_per_segment * constant + 0.5 * self._sums((new**2).sum(axis=1))
        if 0 in self.signals.sensor.places:
            found += 0.5 * (self._means(errors[..., 0]) / LEVEL) ** 2
        return found

    def normal_equations(self, parameters: Parameters, names: Sequence[str]) -> NormalEquations:
        """Value, gradient and Gauss-Newton curvature, with the best noise model at each point.

        Args:
            parameters: where.
            names: d names of `parameters.COMPONENTS`.
        """
        value, scores, curvatures = self.derivatives(parameters, names)
        total = curvatures.sum(axis=0)
        return NormalEquations(value, scores.sum(axis=0), total, total)

    def derivatives(
        self, parameters: Parameters, names: Sequence[str]
    ) -> tuple[float, Float[np.ndarray, "S d"], Float[np.ndarray, "S d d"]]:
        """Value, and what each segment of flight adds to its gradient and curvature.

        As `one_step.OneStep.derivatives`: what a change of the autoregression could do as well is
        taken from every slope, and constant torques are found by their moment.
        """
        errors, slopes = self._slopes(parameters, names)
        products = self._products(errors)
        noise = noise_model(products / self.rows)
        value = float(self._minus_log_likelihood(errors, noise).sum() / self.rows)
        scores = np.zeros((self.segments, len(names)))
        curvatures = np.zeros((self.segments, len(names), len(names)))
        moment = np.array([name in BY_MOMENT for name in names])
        whitened = _whitened(slopes, noise)
        for place in range(errors.shape[-1]):
            late, steep = self._late(errors[..., place]), self._counted(slopes[..., place, :])
            flat, past = self._counted(whitened[..., place, :]), late[:, 1:]
            if self.order:
                weights = np.linalg.lstsq(products[place, 1:, 1:], past.T @ flat, rcond=1e-12)[0]
                flat = flat - past @ weights
            new = late @ np.concatenate([[1.0], -noise.coefficients[place]])
            whole = np.sqrt(products[place, 0, 0] / self.rows)
            slope = np.where(moment, steep / whole, flat)
            error = np.where(moment, late[:, :1] / whole, new[:, None] / noise.deviation[place])
            scores += self._sums(slope * error)
            both = self._sums(slope[:, :, None] * slope[:, None])
            curvatures += np.where(moment[:, None] == moment, both, 0.0)
        if 0 in self.signals.sensor.places:
            tilt = self._means(slopes[..., 0, :]) / LEVEL
            scores += tilt * (self._means(errors[..., 0]) / LEVEL)[:, None]
            curvatures += tilt[:, :, None] * tilt[:, None]
        for name, (mean, deviation) in self.priors.items():
            away = (float(component(parameters, name)) - mean) / deviation
            value += 0.5 * away**2 / self.rows
            mine = np.array([one == name for one in names]) / deviation
            scores += away * mine / self.segments
            curvatures += np.outer(mine, mine) / self.segments
        return value, scores / self.rows, curvatures / self.rows

    def _slopes(
        self, parameters: Parameters, names: Sequence[str]
    ) -> tuple[Float[np.ndarray, "M S C"], Float[np.ndarray, "M S C d"]]:
        """Errors, and their derivatives by differences."""
        rotors = self._rotors(parameters)
        here = self._predicted(parameters, rotors)
        slopes = np.empty((*here.shape, len(names)))
        for number, name in enumerate(names):
            value = float(component(parameters, name))
            nudge = _NUDGES.get(name, 0.01 * abs(value))
            ahead = replace(parameters, **{name: np.float32(value + nudge)})
            moved = self.signals.rotors(ahead) if name in MOTORS else rotors
            change = float(component(ahead, name)) - value
            slopes[..., number] = (here - self._predicted(ahead, moved)) / change
        return self.signals.measured - here, slopes


def _whitened(
    errors: Float[np.ndarray, "M S C ..."], noise: NoiseModel
) -> Float[np.ndarray, "M S C ..."]:
    """What of errors, or of their slopes, is new, in units of its standard deviation."""
    return np.stack(
        [
            scipy.signal.lfilter(
                np.concatenate([[1.0], -weights]), 1.0, errors[:, :, place], axis=0
            )
            / deviation
            for place, (weights, deviation) in enumerate(
                zip(noise.coefficients, noise.deviation, strict=True)
            )
        ],
        axis=2,
    )
