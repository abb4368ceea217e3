"""The page in a real browser, from a log of a micro-SD card to C that compiles; and attacks."""

import http.client
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import urllib.request
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import page_client  # noqa: F401, skips without the extra
import pytest

sync_api: Any = pytest.importorskip("playwright.sync_api")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
pytestmark = [
    pytest.mark.night,
    pytest.mark.skipif(CHROMIUM is None, reason="needs chromium"),
]
LONG = 150_000  # [ms]
FEW = {"over": "thrust_to_weight,latency", "evaluations": "15", "trials": "1"}


@contextmanager
def serving(folder: Path) -> Iterator[str]:
    """The page's address while a process serves it."""
    words = [sys.executable, "-m", "maidenflight", "app", str(folder), "--no-browser"]
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        try:
            yield process.stderr.readline().strip()
        finally:
            process.send_signal(signal.SIGINT)
    assert process.returncode == 0


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    home = {**os.environ, "HOME": str(tmp_path_factory.mktemp("home"))}
    with sync_api.sync_playwright() as playwright:
        options = {"args": ["--no-sandbox", "--disable-gpu"], "env": home}
        browser = playwright.chromium.launch(executable_path=CHROMIUM, **options)
        yield browser
        browser.close()


@contextmanager
def shown(browser: Any, address: str, **options: Any) -> Iterator[Any]:
    """The page in a window of its own, whose console must stay empty of errors."""
    context, errors = browser.new_context(**options), []
    page = context.new_page()
    page.on("pageerror", lambda error: errors.append(str(error)))
    said = ("error", "warning")
    page.on("console", lambda one: errors.append(one.text) if one.type in said else None)
    page.goto(address)
    yield page
    context.close()
    # An answer of 422 or 404 is what some tests ask for.
    assert [one for one in errors if "Failed to load resource" not in one] == []


def begin(page: Any, step: str, **fields: str) -> float:
    """Fills in a form and starts its step; returns the seconds to its first words."""
    page.evaluate(f"document.querySelectorAll('#{step} details').forEach(one => one.open = true)")
    for name, value in fields.items():
        page.fill(f"#{step}-{name}", value)
    start = time.monotonic()
    page.click(f"#{step} .go")
    page.wait_for_selector(f"#{step}[data-state=running] .job .now")
    return time.monotonic() - start


def end(page: Any, step: str, state: str = "done") -> str:
    page.wait_for_selector(f"#{step}:is([data-state=done], [data-state=failed])", timeout=LONG)
    said = page.inner_text(f"#{step} .job")
    assert page.get_attribute(f"#{step}", "data-state") == state, said
    return said


def test_a_log_becomes_a_policy_in_c(browser: Any, tmp_path: Path, shared_data: Path) -> None:
    card = shared_data / "usd" / "brushless" / "eckart00"
    if not card.exists():
        pytest.skip("needs the logs of micro-SD cards")
    folder = tmp_path / "run"
    folder.mkdir()
    start = time.monotonic()
    with serving(folder) as address, shown(browser, "about:blank") as page:
        assert urllib.request.urlopen(address).status == 200
        assert time.monotonic() - start < 3, "the first page"
        page.goto(address)
        page.set_input_files("#choose", [str(card)])
        assert "thrust to weight" in end(page, "log")
        flight = page.frame_locator("#log iframe.shown").locator("#scene")
        flight.wait_for(timeout=LONG)
        assert begin(page, "identify", **FEW) < 1
        end(page, "identify")
        drawn = page.frame_locator("#identify iframe.shown").locator("#estimates .panel svg")
        drawn.first.wait_for(timeout=LONG)
        assert page.input_value("#validate-drone") == "drone.toml"

        assert begin(page, "train", updates="50", policies="1") < 1
        live = page.frame_locator("#train iframe.shown").locator("#learning .panel svg")
        live.first.wait_for(timeout=LONG)
        assert page.get_attribute("#train", "data-state") == "running"
        with shown(browser, address) as other:  # a second window sees the same
            other.wait_for_selector("#train[data-state=running] .cancel:not([hidden])")
            page.reload()
            page.wait_for_selector("#train[data-state=running] .job .now")
            other.click("#train .cancel")
            page.wait_for_selector("#train[data-state=cancelled]", timeout=LONG)
            assert "training.npz" in page.inner_text("#train .job")
            page.wait_for_selector("#train iframe.shown", timeout=LONG)  # what was learned stays
            assert page.is_visible("#train .resume")
        assert page.input_value("#train-updates") == "50", "what ran stays in the form"
        page.click("#train .resume")
        page.wait_for_selector("#train[data-state=running]")
        assert "update 50 of 50" not in end(page, "train")
        assert (folder / "policies" / "policy_1.json").exists()

        assert page.input_value("#predict-policies") == "policies"
        assert begin(page, "predict", trials="1", duration="1") < 1
        assert "policy_1" in end(page, "predict")
        begin(page, "export", policy="policies/policy_1.json")
        end(page, "export")
        with page.expect_download() as saved:
            page.click('#export a[href^="zip/"]')
        with zipfile.ZipFile(saved.value.path()) as packed:
            packed.extractall(tmp_path / "c")
        begin(page, "report")
        end(page, "report")
        assert begin(page, "identify", **FEW) < 1
        assert "already there" in end(page, "identify", "failed")
    compiler = shutil.which("cc")
    if compiler:
        for source in (tmp_path / "c").rglob("*.c"):
            words = [compiler, "-std=c99", "-Wall", "-Werror", "-c", source.name, "-o", "made.o"]
            subprocess.run(words, cwd=source.parent, check=True)
    assert list((tmp_path / "c").rglob("*.c"))


def test_what_is_no_log_and_what_is_large(browser: Any, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    wrong, large = tmp_path / "holiday.jpg", tmp_path / "large.csv"
    wrong.write_bytes(b"\xff\xd8\xff" + os.urandom(5000))
    with large.open("wb") as file:
        file.truncate(200_000_000)
    with serving(tmp_path / "run") as address, shown(browser, address) as page:
        page.set_input_files("#choose", [str(wrong)])
        said = end(page, "log", "failed")
        assert "no flight logs" in said
        page.click("#logs-here button")
        page.wait_for_selector("#logs-here:empty", state="attached")
        assert not (tmp_path / "run/logs/holiday.jpg").exists()
        page.set_input_files("#choose", [str(large)])
        page.wait_for_selector("#logs-here li", timeout=LONG)
        assert (tmp_path / "run/logs/large.csv").stat().st_size == 200_000_000
        page.wait_for_selector("#log[data-state=running]", timeout=LONG)
        assert "large.csv" in end(page, "log", "failed")


@pytest.mark.skipif(not hasattr(os, "getuid") or os.getuid() != 0, reason="mounts a small disk")
def test_a_full_disk(browser: Any, tmp_path: Path) -> None:
    folder, large = tmp_path / "run", tmp_path / "large"
    folder.mkdir()
    large.write_bytes(b"x" * 3_000_000)
    mount = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(folder)]
    if subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("cannot mount a small disk here")
    try:
        with serving(folder) as address, shown(browser, address) as page:
            page.set_input_files("#choose", [str(large)])
            page.wait_for_selector("#upload:has-text('Free space')", timeout=LONG)
            assert list((folder / "logs").iterdir()) == []
            page.set_input_files("#choose", [{"name": "a", "mimeType": "", "buffer": b"no log"}])
            assert "no flight logs" in end(page, "log", "failed")
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def test_names_of_scripts_stay_text_and_the_page_fits_a_phone(browser: Any, tmp_path: Path) -> None:
    folder = tmp_path / "<img src=x onerror=alert(1)>"
    (folder / "logs").mkdir(parents=True)
    (folder / "logs" / "<script>alert(2)<:script>").write_text("no log")
    phone = {"viewport": {"width": 390, "height": 844}, "color_scheme": "dark"}
    with serving(folder) as address, shown(browser, address, **phone) as page:
        page.on("dialog", lambda _: pytest.fail("a script of a name ran"))
        begin(page, "log")
        end(page, "log", "failed")
        assert page.inner_text("h1") == folder.name
        wide = "document.documentElement.scrollWidth > innerWidth"
        assert not page.evaluate(wide)
        page.focus("#log-logs")
        for _ in range(3):
            page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement.closest('section').id") == "log"


def test_ten_thousand_requests_read_nothing_and_the_page_stays(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    (tmp_path / "secret").write_text("my secret")
    (folder / "link").symlink_to(tmp_path / "secret")
    with serving(folder) as address:
        found = re.fullmatch(r"http://([\d.]+):(\d+)/([\w-]+)/", address)
        assert found
        host, port, token = found.groups()
        own = {"Origin": f"http://{host}:{port}"}
        tries: list[tuple[str, str, dict[str, str]]] = [
            ("GET", f"/{token}x/state", {}),
            ("GET", "/", {}),
            ("GET", f"/{token}/state", {"Host": "evil.example"}),
            ("POST", f"/{token}/run/doctor", {"Origin": "http://evil.example"}),
            ("POST", f"/{token}/run/doctor", {}),
            ("GET", f"/{token}/file/../secret", {}),
            ("GET", f"/{token}/file/%2e%2e%2fsecret", {}),
            ("GET", f"/{token}/file/link", {}),
            ("POST", f"/{token}/run/identify", own),
            ("DELETE", f"/{token}/logs/..%2fsecret", own),
        ]
        connection = http.client.HTTPConnection(host, int(port), timeout=30)
        for number in range(10_000):
            method, path, headers = tries[number % len(tries)]
            connection.request(method, path, b"{" if method == "POST" else None, headers)
            answer = connection.getresponse()
            content = answer.read()
            assert answer.status in (403, 404, 422), (method, path)
            assert b"my secret" not in content
        connection.request("GET", f"/{token}/state")
        state = connection.getresponse().read()
        assert state.count(b'"state":""') >= 10
        connection.close()
    assert (tmp_path / "secret").read_text() == "my secret"
