"""A page of a folder, asked as its own browser asks it."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("starlette")

from starlette.testclient import TestClient

from maidenflight.integrations.app.guard import Access
from maidenflight.integrations.app.server import make_application

TOKEN = "secret-token"
HOST = "127.0.0.1:8000"
OWN = {"origin": f"http://{HOST}", "sec-fetch-site": "same-origin"}


@contextmanager
def opened(
    folder: Path, password: str | None = None, host: str = "127.0.0.1"
) -> Iterator[TestClient]:
    """The page's client, which knows token and origin."""
    access = Access(TOKEN, host, 8000, password)
    address = f"http://{HOST}/{TOKEN}/"
    with TestClient(make_application(folder, access), address, headers=OWN) as client:
        yield client
