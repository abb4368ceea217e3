"""The command drone: parameters of a named drone, or of a file, as TOML."""

import json
from pathlib import Path
from typing import Any

import click

from maidenflight.cli import options


@click.command()
@click.argument("name", default="crazyflie")
@click.option("--list", "listed", is_flag=True, help="Print the named drones instead.")
@options.mass
@options.output("File to write; standard output unless given.")
@options.as_json
@options.overwrite
def drone(
    name: str,
    listed: bool,
    mass: float | None,
    output: Path | None,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Print a drone's parameters as TOML.

    NAME is a named drone (--list prints them) or a TOML file, which is checked.
    """
    if listed:
        _list(as_json)
        return
    from maidenflight import parameters, results

    kilograms = None if mass is None else mass / 1e3
    read = parameters.read(name, kilograms)
    sources = parameters.sources(name, kilograms) if name in parameters.DRONES else {}
    record = {}
    if output is not None:
        options.must_be_new(output, overwrite)
        inputs = [name] if Path(name).is_file() else []
        settings = {"drone": Path(name).name, "mass": kilograms}
        record = results.record(seed=None, inputs=inputs, settings=settings)
        text = parameters.to_toml(read, output.stem, {"record": record}, sources)
        results.write(output, text)
    if as_json:
        content = {
            "name": parameters.name_of(name),
            "parameters": {
                field: {
                    "value": parameters.plain(getattr(read, field)),
                    "unit": quantity.unit,
                    "meaning": quantity.meaning,
                }
                for field, quantity in parameters.QUANTITIES.items()
            },
        }
        print(json.dumps(content | ({} if output is None else {"output": str(output)})))
    elif output is None:
        print(parameters.to_toml(read, parameters.name_of(name), sources=sources), end="")


def _list(as_json: bool) -> None:
    from maidenflight import parameters, terminal

    rows: list[dict[str, Any]] = []
    for name, one in parameters.DRONES.items():
        mass = None if one.frameless else round(float(one.make().mass), 6)
        rows.append({"name": name, "mass": mass, "summary": one.summary})

    def text() -> None:
        terminal.table(
            "Named drones",
            ["name", "what", "mass"],
            [
                [
                    row["name"],
                    row["summary"],
                    "--mass" if row["mass"] is None else f"{1e3 * row['mass']:.4g} g",
                ]
                for row in rows
            ],
            numbers_from=2,
        )

    options.emit(as_json, {"drones": rows}, text)
