"""How well a drone's parameters predict real flight times of the authors' policies.

`python paper/measured/predict_flights.py --authors ../shared/data/authors --drone drone.toml` flies
every published policy in simulation, prints how predicted and measured mean flight times agree,
control structure by control structure, beside how one real flight agrees with the others of its
policy, and what share of real flights lies within the band of 10 to 90 % of the predicted ones (80
% if predictions were right, more where many reach the time limit), and draws predicted over
measured times as SVG. `--json` prints one object instead of the table.
"""

import argparse
import json
from pathlib import Path

import jax
import numpy as np
import polars
from agreement import GRONAUER_2021, Agreement, agreement

from maidenflight import compiler, results
from maidenflight.errors import InputError
from maidenflight.experiments.drones import choose_prediction, possible_drones
from maidenflight.experiments.flight_times import predict_flight_times, summary
from maidenflight.integrations.exporters.authors_json import EPSILON, interface_of
from maidenflight.policy import Policy
from maidenflight.reporting.figures import charts, picture
from maidenflight.reporting.figures.charts import Entry, Figure, Spec
from maidenflight.reporting.figures.flight_times import COLOURS

LONGEST = 20.0
"""Of the flights [s]."""


def read_published(folder: Path) -> tuple[dict[str, Policy], polars.DataFrame]:
    """The authors' policies by "control/number", and their flights: name, control, flight_time_s.

    Raises:
        InputError: the folder lacks `policies.npz` or `flights.csv`.
    """
    try:
        archive, flights = np.load(folder / "policies.npz"), polars.read_csv(folder / "flights.csv")
    except OSError as error:
        raise InputError(
            f"{folder}: not the authors' data ({error}). Give the folder with policies.npz and "
            "flights.csv."
        ) from error
    policies = {}
    for place, (kind, number) in enumerate(
        zip(archive["control"].tolist(), archive["policy"].tolist(), strict=True)
    ):
        weights, biases = (
            tuple(archive[f"{name}{layer}"][place] for layer in range(3)) for name in "Wb"
        )
        deviation = archive["observation_std"][place] + np.float32(EPSILON)
        policies[f"{kind}/{number}"] = Policy(
            weights,
            biases,
            archive["observation_mean"][place],
            deviation,
            interface=interface_of(kind),
        )
    name = polars.concat_str(
        "control", polars.col("policy").cast(polars.String), separator="/"
    ).alias("name")
    return policies, flights.select(name, "control", "flight_time_s")


def one_against_others(flights: polars.DataFrame) -> Agreement:
    """Agreement of one real flight with the mean of the others of its policy: the noise ceiling."""
    single, others = [], []
    for (_,), own in flights.group_by("name", maintain_order=True):
        times = own["flight_time_s"].to_numpy()
        single += times.tolist()
        others += ((times.sum() - times) / (len(times) - 1)).tolist()
    return agreement(np.array(single), np.array(others))


def within_band(compared: polars.DataFrame, flights: polars.DataFrame) -> float:
    """Share of real flights between the 10 % and 90 % quantiles of their policy's predictions."""
    joined = flights.join(
        compared.select("policy", "quantile_10", "quantile_90"), left_on="name", right_on="policy"
    )
    durations = joined["flight_time_s"].to_numpy()
    return float(
        np.mean(
            (joined["quantile_10"].to_numpy() <= durations)
            & (durations <= joined["quantile_90"].to_numpy())
        )
    )


def table(compared: polars.DataFrame, flights: polars.DataFrame) -> polars.DataFrame:
    """Agreement of each control structure and of all, and its noise floor."""
    rows = []
    for kind in [*COLOURS, "all"]:
        chosen, own = (
            part if kind == "all" else part.filter(polars.col("control") == kind)
            for part in (compared, flights)
        )
        shares, floor = (
            agreement(chosen["mean"].to_numpy(), chosen["measured"].to_numpy()),
            one_against_others(own),
        )
        rows.append(
            {
                "control": kind,
                "policies": shares.policies,
                "predicted [s]": chosen["mean"].mean(),
                "measured [s]": chosen["measured"].mean(),
                "Spearman": shares.spearman,
                "Pearson": shares.pearson,
                "error [s]": shares.mean_absolute_error,
                "within 10 to 90 %": within_band(chosen, own),
                "floor: Spearman": floor.spearman,
                "floor: Pearson": floor.pearson,
                "floor: error [s]": floor.mean_absolute_error,
            }
        )
    return polars.DataFrame(rows)


def chart(compared: polars.DataFrame) -> Figure:
    """Predicted over measured mean flight times; a bar spans the predictions' 10 % to 90 %."""
    x, y = (
        charts.number(name, f"{words} mean flight time [s]", **charts.within(0.0, LONGEST))
        for name, words in (("measured", "measured"), ("mean", "predicted"))
    )
    colour = charts.coloured(COLOURS, "control")
    low = {**y, "field": "quantile_10"}
    equal = {"type": "line", "color": charts.paint("line"), "strokeWidth": 1}
    ends = {"values": [{"measured": end, "mean": end} for end in (0.0, LONGEST)]}
    span = {"x": x, "y": low, "y2": {"field": "quantile_90"}, "color": colour}
    layers: list[Spec] = [
        {"data": ends, "mark": equal, "encoding": {"x": x, "y": y}},
        {"mark": {"type": "rule", "opacity": 0.3}, "encoding": span},
        {
            "mark": {"type": "point", "filled": True, "opacity": 1},
            "encoding": {"x": x, "y": y, "color": colour},
        },
    ]
    names = ("measured", "mean", "quantile_10", "quantile_90", "control")
    data = charts.table({name: compared[name] for name in names})
    legend = [Entry(kind.replace("_", " "), colour, "dot") for kind, colour in COLOURS.items()]
    panel = charts.panel(data, layers, height=340, zooms=())
    return Figure("Predicted over measured flight times", [panel], legend)


def main() -> None:
    """Reads, flies, prints and draws."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--authors", type=Path, required=True, help="folder with policies.npz and flights.csv"
    )
    parser.add_argument(
        "--drone",
        default="crazyflie",
        help="TOML file of a drone, or its name (default: crazyflie)",
    )
    parser.add_argument(
        "--as-it-is",
        action="store_true",
        help="fly the drone itself, not one of its trims in each flight",
    )
    parser.add_argument(
        "--trials", type=int, default=16, help="flights of each policy (default: 16)"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--json",
        action="store_true",
        help="print one JSON object: the table's rows, and a row a policy",
    )
    parser.add_argument(
        "--chart",
        type=Path,
        default=Path("predicted_flights.svg"),
        help="where to draw (default: %(default)s)",
    )
    options = parser.parse_args()
    try:
        policies, flights = read_published(options.authors)
        drone = possible_drones(
            options.drone,
            0.0 if options.as_it_is else choose_prediction(options.drone),
            options.seed,
        )
        durations = predict_flight_times(
            list(policies.values()),
            drone,
            jax.random.key(options.seed),
            trials=options.trials,
            names=list(policies),
            conditions=GRONAUER_2021,
        )
        measured = (
            flights.group_by("name")
            .agg(polars.col("flight_time_s").mean().alias("measured"))
            .rename({"name": "policy"})
        )
        compared = summary(durations).join(measured, on="policy", maintain_order="left")
        if options.json:
            print(
                json.dumps(
                    {
                        "agreement": table(compared, flights).to_dicts(),
                        "policies": compared.to_dicts(),
                    }
                )
            )
        else:
            with polars.Config(
                tbl_cols=-1,
                tbl_rows=-1,
                tbl_width_chars=200,
                float_precision=2,
                tbl_hide_column_data_types=True,
            ):
                print(table(compared, flights))
        results.write(options.chart, picture.svg(chart(compared), 440))
    except InputError as error:
        parser.error(str(error))


if __name__ == "__main__":
    compiler.prepare_jax()
    main()
