"""`App`: a run folder as a page in the browser."""

import secrets
import socket
import threading
import webbrowser
from contextlib import suppress
from pathlib import Path

from maidenflight.errors import InputError, imported
from maidenflight.settings import flag, path, setting, text, whole
from maidenflight.verb import Output, Progress, Result, Verb

_LOOPBACK = ("127.0.0.1", "localhost", "::1")
_SHORTEST = 12
"""Characters of a password at least; ours."""


class App(Verb):
    """Show a run folder as a page in the browser.

    Drop logs on it, and go from step to step. FOLDER, this one by default, takes the files; each
    step is a command that runs there, so that it also works from the command line at any time.
    Only who has the address that is printed gets in, from this machine. Ctrl-C ends the page, and
    what runs.
    """

    in_studies, replaces = False, False
    output = Output(None, "")

    folder: Path = setting(path("a folder"), Path(), argument=True)
    port: int = setting(whole(0, 65535), 0, "Port; 0: one that is free.", group="Server")
    no_browser: bool = setting(flag(), False, "Print the address only.")
    host: str = setting(
        text("an address of this machine", "ADDRESS"),
        _LOOPBACK[0],
        "Address to listen at. Another one than this machine's own lets who reaches it, and has "
        "the page's address and the password, read FOLDER and run commands here. Nothing is "
        "encrypted on the way.",
        consent=True,
    )
    password_file: Path | None = setting(
        path("a text file", "FILE"),
        None,
        f"File with a password of {_SHORTEST} characters or more, which such a --host needs.",
        consent=True,
    )

    def check(self) -> None:
        """Refuses a folder that is not there, and a door without a lock."""
        if not self.folder.is_dir():
            raise InputError(f"{self.folder}: no such folder. Make it, or give another one.")
        if self.host in ("0.0.0.0", "::"):
            raise InputError(f"--host {self.host}: give the address that others know this one by.")
        if self.host not in _LOOPBACK and self.password_file is None:
            raise InputError(
                f"--host {self.host}: others could read {self.folder} and run commands here. Add "
                "--password-file FILE, or leave it out."
            )

    def _password(self) -> str | None:
        if self.password_file is None:
            return None
        with suppress(OSError, ValueError):
            password = self.password_file.read_text(encoding="utf-8").partition("\n")[0].strip()
            if len(password) >= _SHORTEST:
                return password
        expected = f"a file that can be read, with {_SHORTEST} characters or more on its first line"
        raise InputError(f"{self.password_file}: no password. Expected {expected}.")

    def compute(self, output: Path | None, progress: Progress) -> Result:
        """Serves the page until Ctrl-C."""
        for package in ("starlette", "uvicorn"):
            imported(package, "app", "the page")
        from maidenflight.integrations.app import guard, server

        password, token = self._password(), secrets.token_urlsafe(24)
        family = socket.AF_INET6 if ":" in self.host else socket.AF_INET
        try:
            listening = socket.create_server((self.host, self.port), family=family)
            # Else an answer's second packet waits 40 ms for the first one's receipt.
            listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError as error:
            raise InputError(
                f"--host {self.host} --port {self.port}: cannot listen there ({error.strerror}). "
                "Choose another port, or leave it out."
            ) from error
        access = guard.Access(token, self.host, listening.getsockname()[1], password)
        progress.log(access.address, always=True)
        if self.host not in _LOOPBACK:
            progress.note(
                f"who reaches {self.host} and knows address and password reads what is in "
                f"{self.folder} and runs commands there; both pass unencrypted"
            )
        if not self.no_browser:
            threading.Timer(0.3, webbrowser.open, (access.address,)).start()
        progress.move(1, 1, "Ctrl-C ends it")
        with suppress(KeyboardInterrupt):
            server.serve(self.folder, access, listening)
        return Result(content={"address": access.address})
