import polars

from scripts import script


def test_errors_are_compared_of_all_policies_and_of_those_that_last() -> None:
    study = script("other_simulators")
    flights = polars.DataFrame(
        {
            "policy": ["a", "a", "b", "c"],
            "position_error": [0.01, 0.03, 0.04, 0.08],
            "duration": [10.0, 10.0, 10.0, 3.0],
        }
    )
    flown = study.means(flights, "flown")
    assert flown["flown_error"].to_list() == [0.02, 0.04, 0.08]
    predicted = flown.rename(
        {"flown_error": "predicted_error", "flown_duration": "predicted_duration"}
    )
    table = flown.join(predicted, on="policy").with_columns(
        predicted_error=polars.col("predicted_error") * polars.Series([1.0, 1.2, 1.3])
    )
    table = table.with_columns(ratio=polars.col("predicted_error") / polars.col("flown_error"))
    assert study.describe(table) == (
        "all: 2 of 3 policies within 25%, ratio 1.20 (1.04 to 1.28), rank 1.00; "
        "lasting: 2 of 2 policies within 25%, ratio 1.10 (1.02 to 1.18), rank 1.00"
    )
