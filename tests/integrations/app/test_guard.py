"""Who gets in: only requests with the token, of this machine's names, and of the page itself."""

import base64
from pathlib import Path

import pytest
from page_client import HOST, TOKEN, opened

PATHS = ("", "state", "asset/app.js", "view/log", "file/mine.txt", "zip/policies")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "mine.txt").write_text("mine")
    return tmp_path


@pytest.mark.parametrize(
    ("headers", "before"),
    [
        ({}, ""),
        ({}, "wrong-token/"),
        ({}, f"{TOKEN[:-1]}/"),
        ({}, f"%2e%2e/{TOKEN}/"),
        ({"host": "evil.example:8000"}, f"{TOKEN}/"),
        ({"host": "127.0.0.1:8001"}, f"{TOKEN}/"),
        ({"host": ""}, f"{TOKEN}/"),
        ({"origin": "http://evil.example"}, f"{TOKEN}/"),
        ({"origin": "null"}, f"{TOKEN}/"),
        ({"origin": "http://127.0.0.1:9000"}, f"{TOKEN}/"),
    ],
)
def test_others_get_nothing_and_run_nothing(
    headers: dict[str, str], before: str, folder: Path
) -> None:
    with opened(folder) as client:
        for path in PATHS:
            answer = client.get(f"http://{HOST}/{before}{path}", headers=headers)
            assert answer.status_code == 403
            assert "mine" not in answer.text
        for method, path in (
            ("POST", "run/doctor"),
            ("POST", "cancel/doctor"),
            ("PUT", "logs/a.csv"),
            ("DELETE", "logs/a.csv"),
        ):
            address = f"http://{HOST}/{before}{path}"
            assert client.request(method, address, headers=headers, content="{}").status_code == 403
        state = client.get("state").json()
    assert all(one["state"] == "" for one in state["steps"].values())
    assert [path.name for path in folder.iterdir()] == ["mine.txt"]


def test_a_page_of_another_site_neither_embeds_nor_asks_with_the_token(folder: Path) -> None:
    foreign = {"sec-fetch-site": "cross-site", "sec-fetch-dest": "iframe"}
    with opened(folder) as client:
        assert client.get("state", headers=foreign).status_code == 403
        assert client.get("", headers=foreign).status_code == 403
        link = {"sec-fetch-site": "cross-site", "sec-fetch-dest": "document"}
        assert client.get("", headers=link).status_code == 200
        assert client.get("state", headers=link).status_code == 403
        del client.headers["origin"]
        assert client.get("state").status_code == 200
        assert client.post("cancel/log").status_code == 403


def test_every_answer_forbids_what_the_page_does_not_need(folder: Path) -> None:
    with opened(folder) as client:
        for path in (*PATHS, "nothing", f"http://{HOST}/wrong/"):
            headers = client.get(path).headers
            policy = headers["content-security-policy"]
            assert "default-src 'none'" in policy
            assert "script-src 'self';" in policy
            assert headers["x-content-type-options"] == "nosniff"
            assert headers["referrer-policy"] == "no-referrer"
            assert ("no-store" in headers["cache-control"]) == (not path.startswith("asset"))


def test_a_password_is_asked_for_beside_the_token(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits = []

    async def sleep(seconds: float) -> None:
        waits.append(seconds)

    monkeypatch.setattr("maidenflight.integrations.app.guard.asyncio.sleep", sleep)

    def with_password(text: str) -> dict[str, str]:
        return {"authorization": f"Basic {base64.b64encode(text.encode()).decode()}"}

    with opened(folder, "a long password", "127.0.0.1") as client:
        answer = client.get("state")
        assert answer.status_code == 401
        assert answer.headers["www-authenticate"].startswith("Basic")
        assert client.get("state", headers=with_password("me:wrong")).status_code == 401
        assert client.get("state", headers={"authorization": "Basic %"}).status_code == 401
        assert waits, "guessing takes its time"
        right = with_password("me:a long password")
        assert client.get("state", headers=right).status_code == 200
        wrong = client.get(f"http://{HOST}/wrong/state", headers=right)
        assert wrong.status_code == 403


def test_the_page_of_another_address_has_that_name_alone(folder: Path) -> None:
    with opened(folder, "a long password", "192.168.1.7") as client:
        assert client.get("state").status_code == 403
        assert client.get("state", headers={"host": "192.168.1.7:8000"}).status_code == 403
        own = {"host": "192.168.1.7:8000", "origin": "http://192.168.1.7:8000"}
        assert client.get("state", headers=own).status_code == 401
