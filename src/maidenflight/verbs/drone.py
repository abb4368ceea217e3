"""`Drone`: parameters of a named drone, or of a file, as TOML."""

from pathlib import Path
from typing import Any

from maidenflight import terminal
from maidenflight.settings import flag, setting
from maidenflight.verb import Output, Progress, Result, Verb
from maidenflight.verbs import logs, shared


class Drone(Verb):
    """Print a drone's parameters as TOML.

    DRONE is a named drone (--list prints them) or a TOML file, which is checked.
    """

    in_studies = False
    output = Output(None, "File to write; standard output unless given.")

    drone: str = shared.drone("crazyflie", argument=True)
    list_names: bool = setting(
        flag(), False, "Print the named drones instead.", name="list", recorded=False
    )
    mass: float | None = shared.mass()

    def compute(self, output: Path | None, progress: Progress) -> Result:
        """Reads and checks the drone; writes it where an output is given."""
        from maidenflight import parameters, results

        if self.list_names:
            return _list()
        kilograms = None if self.mass is None else self.mass / 1e3
        read = parameters.read(self.drone, kilograms)
        sources = (
            parameters.sources(self.drone, kilograms) if self.drone in parameters.DRONES else {}
        )
        content: dict[str, Any] = {
            "name": parameters.name_of(self.drone),
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
            toml = parameters.to_toml(read, parameters.name_of(self.drone), sources=sources)
            return Result(content=content, show=lambda: print(toml, end=""), value=read)
        record = self.make_record(logs.own_files(self.drone))
        toml = parameters.to_toml(read, output.stem, {"record": record}, sources)
        results.write(output, toml)
        return Result(
            content=content | {"output": str(output)},
            value=read,
        )


def _list() -> Result:
    """Lists the named drones."""
    from maidenflight import parameters

    drones = [
        {
            "name": name,
            "mass": None if one.frameless else round(float(one.make().mass), 6),
            "summary": one.summary,
        }
        for name, one in parameters.DRONES.items()
    ]

    def show() -> None:
        masses = [
            "--mass" if row["mass"] is None else f"{1e3 * row['mass']:.4g} g" for row in drones
        ]
        rows = [
            [row["name"], row["summary"], mass] for row, mass in zip(drones, masses, strict=True)
        ]
        terminal.print_table("Named drones", ["name", "what", "mass"], rows, numbers_from=2)

    return Result(content={"drones": drones}, show=show)
