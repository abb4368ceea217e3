"""HTML by Jinja2: what is not `Markup` is escaped, so that no text of a file can become markup."""

import re
from functools import cache
from importlib import resources
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

_PACKAGE = "maidenflight.reporting"


@cache
def _templates(package: str) -> Environment:
    return Environment(
        loader=PackageLoader(package),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def render(template: str, package: str = _PACKAGE, **content: Any) -> Markup:
    """Fills a template of a package, this one by default, without the space around it."""
    return Markup(_templates(package).get_template(template).render(**content).strip())


def asset(name: str, package: str = _PACKAGE) -> Markup:
    """Returns a style sheet or script of a package, this one by default, as it is."""
    return Markup(resources.files(package).joinpath(name).read_text(encoding="utf-8"))


def sendable(text: str) -> str:
    """Returns a page as UTF-8 can hold it; a file's name may hold bytes that are none."""
    return text.encode(errors="backslashreplace").decode()


def style() -> Markup:
    """Returns the style sheet."""
    return asset("colours.css") + _themes() + asset("style.css")


def _themes() -> Markup:
    """Rules for those who choose light or dark themselves; print is always light."""
    light, dark = re.findall(r":root \{(.*?)\}", asset("colours.css"), re.DOTALL)
    return Markup(
        f":root[data-theme=light] {{{light}  color-scheme: light;\n}}\n"
        f"@media screen {{ :root[data-theme=dark] {{{dark}  color-scheme: dark;\n}} }}\n"
    )
