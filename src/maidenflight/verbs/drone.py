"""`Drone`: parameters of a named drone, or of a file, as TOML or for another program."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight import results
from maidenflight.errors import InputError
from maidenflight.registry import DRONE_FORMATS
from maidenflight.settings import flag, name_of, setting, text, whole
from maidenflight.terminal import Table
from maidenflight.verb import Output, Progress, Result, Verb
from maidenflight.verbs import shared

if TYPE_CHECKING:
    from maidenflight.parameters import Parameters


class Drone(Verb):
    """Print a drone as TOML or for another program.

    DRONE is a named drone (--list prints them) or a TOML file, which is checked.
    """

    in_studies = False
    output = Output(None, "File to write, or folder for --samples; standard output by default.")

    drone: str = shared.drone("crazyflie", argument=True)
    list_names: bool = setting(
        flag(), False, "Print the named drones instead.", name="list", recorded=False
    )
    mass: float | None = shared.mass()
    to: str | None = setting(
        name_of(DRONE_FORMATS),
        None,
        "Program that reads it: mjcf (MuJoCo), urdf (gym-pybullet-drones), sdf (Gazebo), rotorpy, "
        "crazyflow, isaac-lab, l2f, px4, ardupilot, betaflight. What its format cannot hold is "
        "written as comments.",
        group="Other programs",
    )
    full_speed: str | None = setting(
        text("a speed [rpm] or flight logs", "RPM|LOGS"),
        None,
        "Speed of the rotors at full command, for formats with rotor speeds: a number [rpm], or "
        "logs with measured speeds.",
        files=True,
    )
    samples: int | None = setting(
        whole(1, 10_000),
        None,
        "Drones of the posterior to write, a file each, for domain randomization.",
    )

    def check_early(self) -> None:
        """Refuses what only another program's format needs."""
        for name in ("full_speed", "samples"):
            if self.to is None and getattr(self, name):
                option = name.replace("_", "-")
                raise InputError(f"--{option} is of no use without --to FORMAT; leave it out.")

    def compute(self, output: Path | None, progress: Progress) -> Result:
        """Reads and checks the drone; writes it where there is an output."""
        from maidenflight import parameters

        if self.list_names:
            return _list()
        kilograms = None if self.mass is None else self.mass / 1e3
        is_named = self.drone in parameters.DRONES
        read, name = parameters.read_drone(self.drone, kilograms), parameters.name_of(self.drone)
        record = self.make_record(shared.own_files(self.drone))
        if self.to is not None:
            return self._export(read, name, output, record, progress)
        sources = parameters.sources(self.drone, kilograms) if is_named else {}
        content: dict[str, Any] = {
            "name": name,
            "parameters": {
                field: {
                    "value": parameters.plain(getattr(read, field)),
                    "unit": quantity.unit,
                    "meaning": quantity.meaning,
                }
                for field, quantity in parameters.QUANTITIES.items()
            },
        }
        if output is None:
            toml = parameters.to_toml(read, name, sources=sources)
            return Result(content=content, summary=[toml.removesuffix("\n")], value=read)
        results.write(output, parameters.to_toml(read, output.stem, {"record": record}, sources))
        return Result(content=content | {"output": str(output)}, value=read)

    def _export(
        self,
        drone: "Parameters",
        name: str,
        output: Path | None,
        record: dict[str, Any],
        progress: Progress,
    ) -> Result:
        """Writes the drone, or drones of its posterior, in another program's format."""
        from maidenflight.deployment.drone_format import drone_text

        to, samples = str(self.to), self._samples(drone)
        if self.samples is not None and self.samples > len(samples):
            raise InputError(
                f"{self.drone}: its posterior has {len(samples)} samples, fewer than "
                f"{self.samples}. Give fewer, or a drone that flights identified by likelihood."
            )
        if self.samples and output is None:
            raise InputError(f"--samples {self.samples}: give -o FOLDER for as many files.")
        options: dict[str, Any] = {"full_speed": self._rpm(drone), "record": record}
        if self.samples is not None and output is not None:
            written = []
            for number, sample in enumerate(samples[: self.samples], 1):
                text = drone_text(sample, to, name, **options)
                path = output / f"{name}_{number:03}{DRONE_FORMATS[to].ending}"
                written.append(results.write(path, text))
                progress.move(number, self.samples)
            return Result(content={"files": [str(path) for path in written]}, value=written)
        text = drone_text(drone, to, name, samples=samples, **options)
        if output is None:
            return Result(content={"text": text}, summary=[text.removesuffix("\n")], value=text)
        path = results.write(output, text)
        return Result(content={"files": [str(path)]}, value=[path])

    def _samples(self, drone: "Parameters") -> "list[Parameters]":
        """Drones of the posterior; none of a drone without one."""
        import jax

        from maidenflight.identification import drone_file

        posterior = drone_file.read(self.drone).posterior
        if not posterior:
            return []
        drones = posterior.ensemble(drone, self.drone).drones
        return [
            jax.tree.map(lambda leaf, index=index: leaf[index], drones)
            for index in range(len(drones.mass))
        ]

    def _rpm(self, drone: "Parameters") -> float | None:
        """The rotors' full speed [rpm], as given or as logs measured it."""
        if self.full_speed is None:
            return None
        try:
            return float(self.full_speed)
        except ValueError:
            from maidenflight.deployment.drone_format import RPM
            from maidenflight.flights.full_speed import full_speed
            from maidenflight.flights.reading import read_flights

            flights = read_flights(self.full_speed).flights
            return RPM * full_speed(flights, drone, self.full_speed)


def _list() -> Result:
    from maidenflight.parameters import DRONES

    drones = [
        {
            "name": name,
            "mass": None if drone.frameless else round(float(drone.make().mass), 6),
            "summary": drone.summary,
        }
        for name, drone in DRONES.items()
    ]
    columns = {"name": "{name}", "what": "{summary}", "mass": "{mass:.4g g}"}
    return Result(
        content={"drones": drones},
        summary=[
            Table("Named drones", columns, drones),
            "where no mass stands, give yours by --mass",
        ],
    )
