"""`Drone`: parameters of a named drone, or of a file, as TOML."""

from pathlib import Path
from typing import Any

from maidenflight import results
from maidenflight.settings import flag, setting
from maidenflight.terminal import Table
from maidenflight.verb import Output, Progress, Result, Verb
from maidenflight.verbs import shared


class Drone(Verb):
    """Print a drone's parameters as TOML.

    DRONE is a named drone (--list prints them) or a TOML file, which is checked.
    """

    in_studies = False
    output = Output(None, "File to write; standard output by default.")

    drone: str = shared.drone("crazyflie", argument=True)
    list_names: bool = setting(
        flag(), False, "Print the named drones instead.", name="list", recorded=False
    )
    mass: float | None = shared.mass()

    def compute(self, output: Path | None, progress: Progress) -> Result:
        """Reads and checks the drone; writes it where there is an output."""
        from maidenflight import parameters

        if self.list_names:
            return _list()
        kilograms = None if self.mass is None else self.mass / 1e3
        is_named = self.drone in parameters.DRONES
        read, name = parameters.read_drone(self.drone, kilograms), parameters.name_of(self.drone)
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
        record = self.make_record(shared.own_files(self.drone))
        results.write(output, parameters.to_toml(read, output.stem, {"record": record}, sources))
        return Result(content=content | {"output": str(output)}, value=read)


def _list() -> Result:
    from maidenflight import parameters

    drones = [
        {
            "name": name,
            "mass": None if one.frameless else round(float(one.make().mass), 6),
            "summary": one.summary,
        }
        for name, one in parameters.DRONES.items()
    ]
    columns = {"name": "{name}", "what": "{summary}", "mass": "{mass:.4g g}"}
    return Result(
        content={"drones": drones},
        summary=[
            Table("Named drones", columns, drones),
            "where no mass stands, give yours by --mass",
        ],
    )
