"""`Posterior`: joint samples of a drone's parameters, to draw, summarise, plot, save and check."""

from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import jax
import numpy as np
import polars
from jaxtyping import Array, ArrayLike, Float

from maidenflight import results
from maidenflight.errors import InputError
from maidenflight.identification.uncertainty import interval
from maidenflight.inputs import StrPath
from maidenflight.parameters import COMPONENTS, QUANTITIES, Parameters, check, component, replace
from maidenflight.registry import PLOTS
from maidenflight.simulator.randomization import Ensemble, ensemble


class Posterior(Mapping[str, Float[np.ndarray, "N"]]):
    """Joint samples of parameters: a mapping from names to N values in SI units.

    The n-th values of all parameters belong together.
    """

    def __init__(self, samples: Mapping[str, ArrayLike]):
        """Takes samples by name of `parameters.COMPONENTS`.

        Raises:
            InputError: parameters have different numbers of samples.
        """
        self._samples = {name: np.asarray(values) for name, values in samples.items()}
        counts = {name: values.shape for name, values in self._samples.items()}
        if len(set(counts.values())) > 1 or any(len(shape) != 1 for shape in counts.values()):
            raise InputError(
                f"a posterior of {counts}; expected as many samples of each parameter, as one axis."
            )

    def __getitem__(self, name: str) -> Float[np.ndarray, "N"]:
        """Returns the samples of a parameter."""
        return self._samples[name]

    def __iter__(self) -> Iterator[str]:
        """Gives the parameters' names."""
        return iter(self._samples)

    def __len__(self) -> int:
        """Returns how many parameters there are."""
        return len(self._samples)

    def __repr__(self) -> str:
        """Returns a line for each parameter: its median and 95 % interval."""
        head = f"posterior: {self.size} samples; SI units: median, 95 % interval"
        rows = (
            f"{row['parameter']:24}{row['median']:12.4g}  [{row['low']:.4g}, {row['high']:.4g}]"
            for row in self.summary().iter_rows(named=True)
        )
        return "\n".join([head, *rows])

    def ensemble(self, drone: Parameters, source: str = "drone.toml") -> Ensemble:
        """Returns the samples as drones to train over.

        Args:
            drone: of the other parameters.
            source: the drone's file, for errors.

        Raises:
            InputError: there are no samples, or one is outside its physical range.
        """
        if not self.size:
            raise InputError(
                f"{source}: no [posterior] to draw drones from. Make the file with: maidenflight "
                f"identify LOGS -o {source}."
            )
        rows = np.stack(list(self.values()), axis=1).astype(np.float32)
        return ensemble(
            [
                check(
                    replace(drone, **dict(zip(self, row, strict=True))), f"{source} [posterior] {i}"
                )
                for i, row in enumerate(rows, 1)
            ]
        )

    @property
    def size(self) -> int:
        """Samples of each parameter, N."""
        return len(next(iter(self._samples.values()), ()))

    def sample(self, count: int, key: Array | None = None) -> "Posterior":
        """Draws joint samples, with replacement where more are asked for than there are.

        Args:
            count: how many.
            key: random key; `jax.random.key(0)` by default.

        Raises:
            InputError: there are none to draw from.
        """
        if not self.size:
            raise InputError("a posterior without samples; identify the drone from flights.")
        key = jax.random.key(0) if key is None else key
        chosen = jax.random.choice(key, self.size, (count,), replace=count > self.size)
        rows = np.asarray(chosen)
        return Posterior({name: values[rows] for name, values in self.items()})

    def summary(self) -> polars.DataFrame:
        """Returns a row for each parameter: unit, mean, sd, low, median and high.

        `low` and `high` are the ends of the central 95 % interval.
        """
        rows = []
        for name, values in self.items():
            low, high = map(float, interval(values))
            unit = QUANTITIES[COMPONENTS[name][0]].unit if name in COMPONENTS else ""
            median, mean, deviation = (float(of(values)) for of in (np.median, np.mean, np.std))
            rows.append((name, unit, mean, deviation, low, median, high))
        schema = ("parameter", "unit", "mean", "sd", "low", "median", "high")
        return polars.DataFrame(rows, schema=schema, orient="row")

    def coverage(self, truth: Parameters | Mapping[str, float]) -> polars.DataFrame:
        """Compares the samples with what is true of the drone.

        Args:
            truth: a drone, or SI values by parameter; parameters that it lacks are left out.

        Returns:
            A row for each parameter: truth, its rank (the share of samples below it, uniform over
            many drones if the posterior is right), z (its distance from the mean in standard
            deviations), and whether the 95 % interval holds it.

        Source: Cook, Gelman and Rubin 2006, Validation of software for Bayesian models.
        """
        rows = []
        for name, values in self.items():
            if isinstance(truth, Parameters):
                true = float(component(truth, name))
            elif name in truth:
                true = float(truth[name])
            else:
                continue
            low, high = interval(values)
            away = (true - float(np.mean(values))) / max(float(np.std(values)), 1e-30)
            rank = float(np.mean(values < true))
            rows.append((name, true, rank, away, bool(low <= true <= high)))
        schema = {"parameter": polars.String, "truth": polars.Float64, "rank": polars.Float64}
        schema |= {"z": polars.Float64, "is_held": polars.Boolean}
        return polars.DataFrame(rows, schema=schema, orient="row")

    def plot_corner(self, optimum: Mapping[str, float] | None = None) -> Any:
        """Returns a picture of each pair of parameters, which a notebook shows.

        Args:
            optimum: values that are marked, by parameter.
        """
        return PLOTS["posterior"](self, optimum)

    def to_polars(self) -> polars.DataFrame:
        """Returns a table with a column for each parameter and a row for each sample."""
        return polars.DataFrame(dict(self))

    def to_pandas(self) -> Any:
        """Returns the same as a pandas table.

        Raises:
            ImportError: pandas is not installed.
        """
        return import_module("pandas").DataFrame(dict(self))

    def to_arviz(self) -> Any:
        """Returns the samples as ArviZ has them, one chain: `InferenceData`, since 1.0 a DataTree.

        Raises:
            ImportError: ArviZ is not installed.
        """
        arviz = import_module("arviz")
        chain = {name: np.asarray(values, float)[None] for name, values in self.items()}
        if hasattr(arviz, "InferenceData"):
            return arviz.from_dict(posterior=chain)
        return arviz.from_dict({"posterior": chain})

    def write(self, path: StrPath) -> None:
        """Writes the table of samples as CSV, which `read` reads.

        Raises:
            WriteError: the file cannot be written.
        """
        results.write(path, self.to_polars().write_csv())

    @classmethod
    def read(cls, path: StrPath) -> "Posterior":
        """Reads a table that `write` wrote.

        Raises:
            InputError: the file is no table of numbers, or has other columns than parameters.
        """
        try:
            numbers = dict.fromkeys(COMPONENTS, polars.Float64)
            table = polars.read_csv(Path(path), schema_overrides=numbers)
        except (OSError, polars.exceptions.PolarsError) as error:
            raise InputError(f"{path}: not a table of samples ({error}).") from error
        unknown = sorted(set(table.columns) - COMPONENTS.keys())
        if unknown:
            raise InputError(
                f"{path}: columns that are no parameters: {', '.join(unknown)}. Expected a table "
                "that Posterior.write wrote."
            )
        return cls({name: table[name].to_numpy() for name in table.columns})
