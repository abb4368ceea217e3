"""How policies learned."""

import polars
from markupsafe import Markup

from maidenflight.reporting import text
from maidenflight.reporting.figures import training
from maidenflight.reporting.html import render
from maidenflight.reporting.run import Run


def section(run: Run) -> Markup:
    """Returns how policies learned."""
    rows = run.training
    if rows is None:
        return Markup()
    policies = rows["policy"].n_unique()
    last = rows.filter(polars.col("steps") == rows["steps"].max())["episode_return"].to_numpy()
    return render(
        "training.html",
        curves=training.learning_curves(rows),
        policies=text.plural(policies, "policy"),
        range=[text.number(end, 3) for end in (last.min(), last.max())] if policies > 1 else [],
    )
