"""Errors of what a sensor measures, and their likelihood: no state is needed.

What is measured follows from the rotors' speeds, and these from the logged commands. Errors are an
autoregression over the last quarter of a second; `one_step` says why. `SensorErrors` turns any
prediction of that kind into an observation model.

Source: Ljung 1999, System identification: theory for the user, ch. 7 and 13.4 (prediction errors,
closed loop).
"""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import ClassVar, Self

import numpy as np
import scipy
from jaxtyping import Float
from numpy.lib.stride_tricks import sliding_window_view

from maidenflight.flights.log import Flight
from maidenflight.identification.likelihood.observation import (
    BY_MOMENT,
    MOTORS,
    NoiseModel,
    ObservationModel,
    noise_model,
)
from maidenflight.identification.likelihood.selection import Parts
from maidenflight.identification.likelihood.sensor_signals import (
    Rotors,
    Sensor,
    Signals,
    angular_acceleration,
    low_pass,
    mean_force,
    signals,
)
from maidenflight.identification.signals.thrust_law import MEMORY
from maidenflight.identification.unknowns import UNKNOWNS
from maidenflight.parameters import Parameters, component, levers, replace

EVALUATIONS = 20
"""Of a sensor's likelihood at most; harmless within a factor of 1.4
(paper/identification/constants.py)."""
_MEMORY = MEMORY / 2
"""Time that the noise model looks back [s]; the motors' lag takes the rest of `MEMORY`."""


class SensorErrors(ObservationModel):
    """Minus the mean log likelihood of a step of a sensor's signals.

    A sensor says what it measures (`sensor`) and what that follows from (`predicted`). Slopes are
    differences, by which the rest follows; all but the motors' are constant over them.
    """

    sensor: ClassVar[Sensor]
    """What is measured, and in which steps."""
    levels: ClassVar[Mapping[int, float]] = {}
    """Standard deviation of a segment's mean error, by number of the signal. An autoregression
    hardly weighs what lasts, so that of signals whose mean is known it is said apart."""

    def __init__(
        self,
        signals: Signals,
        priors: Mapping[str, tuple[float, float]] | None = None,
        white: bool = False,
    ):
        """Prepares what does not depend on the drone.

        Args:
            signals: of the sensor.
            priors: mean and standard deviation of what is known beforehand, by parameter.
            white: whether errors are white noise, as in plain least squares.
        """
        self.signals, self.priors = signals, priors or {}
        self.order = 0 if white else round(_MEMORY / signals.step)
        self.rows_per_segment = signals.used.sum(axis=0).astype(float)
        self._latest: tuple[list[float], Rotors] | None = None

    @classmethod
    def of(
        cls,
        flights: Sequence[Flight],
        priors: Mapping[str, tuple[float, float]] | None = None,
        limit: float = np.inf,
    ) -> Self:
        """Returns the model of some flights; see `sensor_signals.signals`.

        Raises:
            InputError: the flights have different rates, or none is long enough.
        """
        return cls(signals(flights, cls.sensor, limit), priors)

    @abstractmethod
    def predicted(self, drone: Parameters, rotors: Rotors) -> Float[np.ndarray, "M S C"]:
        """Returns what the sensor measures of a drone whose rotors do so."""
        ...

    def white(self) -> Self:
        """Returns the same with white noise."""
        return type(self)(self.signals, self.priors, white=True)

    def parts(self) -> Parts | None:
        """Returns segments to fit and others to judge by; see `Signals.parted`."""
        parts = self.signals.parted()
        if parts is None:
            return None
        training, held_out = (type(self)(some, self.priors) for some in parts)
        return Parts(training, held_out, training)

    def _rotors(self, drone: Parameters) -> Rotors:
        """The rotors of a drone; those of the last one stay, since many share their motors."""
        motors = [float(component(drone, name)) for name in MOTORS]
        if self._latest is None or self._latest[0] != motors:
            self._latest = motors, self.signals.rotors(drone)
        return self._latest[1]

    def errors(self, parameters: Parameters) -> Float[np.ndarray, "M S C"]:
        """Returns measured minus predicted, signal by signal."""
        return self.signals.measured - self.predicted(parameters, self._rotors(parameters))

    def noise_model(self, parameters: Parameters) -> NoiseModel:
        """See `ObservationModel`."""
        return noise_model(self._products(self.errors(parameters)) / self.rows)

    def _products(self, errors: Float[np.ndarray, "M S C"]) -> Float[np.ndarray, "C P+1 P+1"]:
        """Products of errors with themselves 0 ... P steps before, summed."""
        late = (self._late(errors[..., channel]) for channel in range(errors.shape[-1]))
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

    def per_segment(self, parameters: Parameters, noise: NoiseModel) -> Float[np.ndarray, "S"]:
        """See `ObservationModel`."""
        return self._minus_log_likelihood(self.errors(parameters), noise)

    def _minus_log_likelihood(
        self, errors: Float[np.ndarray, "M S C"], noise: NoiseModel
    ) -> Float[np.ndarray, "S"]:
        constant = np.sum(np.log(noise.deviation) + 0.5 * np.log(2 * np.pi))
        new = self._counted(_whitened(errors, noise))
        value = self.rows_per_segment * constant + 0.5 * self._sums((new**2).sum(axis=1))
        for channel, level in self.levels.items():
            value += 0.5 * (self._means(errors[..., channel]) / level) ** 2
        return value

    def derivatives(
        self, parameters: Parameters, names: Sequence[str]
    ) -> tuple[float, Float[np.ndarray, "S d"], Float[np.ndarray, "S d d"]]:
        """Returns `ObservationModel.derivatives`, priors included."""
        errors, slopes = self._slopes(parameters, names)
        products = self._products(errors)
        noise = noise_model(products / self.rows)
        value = float(self._minus_log_likelihood(errors, noise).sum() / self.rows)
        scores = np.zeros((self.segments, len(names)))
        curvatures = np.zeros((self.segments, len(names), len(names)))
        moment = np.array([name in BY_MOMENT for name in names])
        whitened = _whitened(slopes, noise)
        for channel in range(errors.shape[-1]):
            late, steep = self._late(errors[..., channel]), self._counted(slopes[..., channel, :])
            flat, past = self._counted(whitened[..., channel, :]), late[:, 1:]
            if self.order:
                weights = np.linalg.lstsq(products[channel, 1:, 1:], past.T @ flat, rcond=1e-12)[0]
                flat = flat - past @ weights
            new = late @ np.concatenate([[1.0], -noise.coefficients[channel]])
            whole = np.sqrt(products[channel, 0, 0] / self.rows)
            slope = np.where(moment, steep / whole, flat)
            error = np.where(moment, late[:, :1] / whole, new[:, None] / noise.deviation[channel])
            scores += self._sums(slope * error)
            both = self._sums(slope[:, :, None] * slope[:, None])
            curvatures += np.where(moment[:, None] == moment, both, 0.0)
        for channel, level in self.levels.items():
            tilt = self._means(slopes[..., channel, :]) / level
            scores += tilt * (self._means(errors[..., channel]) / level)[:, None]
            curvatures += tilt[:, :, None] * tilt[:, None]
        for name, (mean, deviation) in self.priors.items():
            away = (float(component(parameters, name)) - mean) / deviation
            value += 0.5 * away**2 / self.rows
            mine = np.array([parameter == name for parameter in names]) / deviation
            scores += away * mine / self.segments
            curvatures += np.outer(mine, mine) / self.segments
        return value, scores / self.rows, curvatures / self.rows

    def _slopes(
        self, parameters: Parameters, names: Sequence[str]
    ) -> tuple[Float[np.ndarray, "M S C"], Float[np.ndarray, "M S C d"]]:
        """Errors, and their derivatives by differences."""
        rotors = self._rotors(parameters)
        here = self.predicted(parameters, rotors)
        slopes = np.empty((*here.shape, len(names)))
        for number, name in enumerate(names):
            value = float(component(parameters, name))
            nudge = UNKNOWNS[name].step or 0.01 * abs(value)
            ahead = replace(parameters, **{name: np.float32(value + nudge)})
            moved = self.signals.rotors(ahead) if name in MOTORS else rotors
            change = float(component(ahead, name)) - value
            slopes[..., number] = (here - self.predicted(ahead, moved)) / change
        return self.signals.measured - here, slopes


def _whitened(
    errors: Float[np.ndarray, "M S C ..."], noise: NoiseModel
) -> Float[np.ndarray, "M S C ..."]:
    """What of errors, or of their slopes, is new, in units of its standard deviation."""
    return np.stack(
        [
            scipy.signal.lfilter(
                np.concatenate([[1.0], -weights]), 1.0, errors[:, :, channel], axis=0
            )
            / deviation
            for channel, (weights, deviation) in enumerate(
                zip(noise.coefficients, noise.deviation, strict=True)
            )
        ],
        axis=2,
    )


LEVEL = 0.02 * 9.81
"""Standard deviation of a segment's mean specific force from the model's [m/s2]: battery, climb,
the sensor's scale."""


class AccelerometerErrors(SensorErrors):
    """The specific force along z, the source's eq:motor-force as a mean over a step."""

    sensor = Sensor(0.010, mean_force)
    levels = {0: LEVEL}

    def predicted(self, drone: Parameters, rotors: Rotors) -> Float[np.ndarray, "M S 1"]:
        """Returns thrust less drag, each over the mass.

        Source: Gronauer et al. 2022, eq:motor-force.
        """
        drag = float(drone.drag[2]) * self.signals.climb
        force = _thrust(drone, rotors).sum(axis=-1) - drag
        late = self.signals.filter_delay
        return (low_pass(force, late, self.signals.step) if late else force)[..., None]


class GyroErrors(SensorErrors):
    """The angular acceleration about each axis.

    In steps of 10 ms, within which a fast controller answers, inertia comes out up to a quarter too
    large where only its own noise moves the drone.
    """

    sensor = Sensor(0.006, angular_acceleration)

    def predicted(self, drone: Parameters, rotors: Rotors) -> Float[np.ndarray, "M S 3"]:
        """Returns the torques over the inertia, means over a step.

        Source: Gronauer et al. 2022, eq:torque, eq:motor-torque and eq:angular-acceleration;
        `dynamics.further_torque` for the rotors' momentum.
        """
        thrust, arms, rates = _thrust(drone, rotors), levers(drone), self.signals.body_rates
        turned = arms * [1.0, 1.0, float(drone.torque_to_thrust)]
        inertia, bias = np.asarray(drone.inertia, float), np.asarray(drone.torque_bias, float)
        lift = thrust.sum(axis=-1) / float(drone.gravity)
        momentum = float(drone.rotor_momentum) * arms[:, 2]
        precession, parts = rotors.mean @ momentum, []
        for axis, second, other in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            torque = bias[axis] * lift + float(drone.mass) * (thrust @ turned[:, axis])
            if axis == 2:
                torque += rotors.change @ momentum / self.signals.step
            else:
                torque -= float(drone.rotational_damping) * rates[..., axis]
                torque += (precession, -precession)[axis] * rates[..., 1 - axis]
            torque -= (inertia[other] - inertia[second]) * rates[..., second] * rates[..., other]
            parts.append(torque / inertia[axis])
        return np.stack(parts, axis=-1)


def _thrust(drone: Parameters, rotors: Rotors) -> Float[np.ndarray, "M S 4"]:
    """Mean thrust of each rotor over the drone's mass [m/s2]."""
    offset, linear = float(drone.thrust_offset), float(drone.thrust_linear)
    share = offset + linear * rotors.mean + (1 - offset - linear) * rotors.square
    return float(drone.gravity * drone.thrust_to_weight) / 4 * share
