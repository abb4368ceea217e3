"""HTML by Jinja2: what is not `Markup` is escaped, so that no text of a file can become markup."""

from functools import cache
from importlib import resources
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

_PACKAGE = "maidenflight.reporting"


@cache
def _templates() -> Environment:
    return Environment(
        loader=PackageLoader(_PACKAGE),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def render(template: str, **content: Any) -> Markup:
    """Fills a template of this package, without the space around it."""
    return Markup(_templates().get_template(template).render(**content).strip())


def asset(name: str) -> Markup:
    """Returns a style sheet or script of this package, as it is."""
    return Markup(resources.files(_PACKAGE).joinpath(name).read_text(encoding="utf-8"))
