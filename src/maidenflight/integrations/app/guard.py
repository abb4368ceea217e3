"""Who gets in: by a token in the path, this machine's names, no other pages, and a password.

Sources: the Fetch standard (Origin, Sec-Fetch-Site); RFC 7617 (Basic authentication).
"""

import asyncio
import base64
import hmac
from dataclasses import dataclass
from typing import TYPE_CHECKING

from starlette.requests import Request
from starlette.responses import PlainTextResponse

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

LOOPBACK = ("127.0.0.1", "localhost", "::1")
_HEADERS = {
    b"content-security-policy": b"default-src 'none'; script-src 'self'; style-src 'self' "
    b"'unsafe-inline'; img-src 'self' data:; connect-src 'self'; frame-src 'self'; "
    b"frame-ancestors 'self'; form-action 'none'; base-uri 'none'",
    b"x-content-type-options": b"nosniff",
    b"referrer-policy": b"no-referrer",
    b"cross-origin-opener-policy": b"same-origin",
    b"cross-origin-resource-policy": b"same-origin",
    b"cache-control": b"no-store",
}


@dataclass(frozen=True)
class Access:
    """What a request must know: token, name of the server with its port, and password."""

    token: str
    host: str
    port: int
    password: str | None = None

    def _address(self, name: str) -> str:
        return f"{f'[{name}]' if ':' in name else name}:{self.port}"

    @property
    def address(self) -> str:
        """Returns the address of the page."""
        return f"http://{self._address(self.host)}/{self.token}/"

    def refuse(self, request: Request, token: str, rest: str) -> str:
        """Returns why a request of a path `/token/rest` is refused; empty where it is not."""
        headers, own = request.headers, LOOPBACK if self.host in LOOPBACK else (self.host,)
        if headers.get("host", "") not in map(self._address, own):
            return "This host name is not that of the page; use the address that was printed."
        if not hmac.compare_digest(token.encode(), self.token.encode()):
            return "The address lacks its token; use the one that was printed."
        origin = headers.get("origin", "" if request.method in ("GET", "HEAD") else "none")
        opens = headers.get("sec-fetch-dest") == "document" and rest == ""
        is_foreign = headers.get("sec-fetch-site", "none") not in ("none", "same-origin")
        if origin not in ("", f"http://{headers['host']}") or (is_foreign and not opens):
            return "Requests of other pages are refused."
        return ""

    def knows_password(self, request: Request) -> bool:
        """Returns whether a request has the password, if there is one."""
        kind, _, code = request.headers.get("authorization", "").partition(" ")
        try:
            password = base64.b64decode(code, validate=True).partition(b":")[2]
        except ValueError:
            return False
        right = hmac.compare_digest(password, (self.password or "").encode())
        return self.password is None or (kind.lower() == "basic" and right)


class Guard:
    """Lets those requests pass to an application that have a right to."""

    def __init__(self, app: "ASGIApp", access: Access) -> None:
        self._app, self._access = app, access

    async def __call__(self, scope: "Scope", receive: "Receive", send: "Send") -> None:
        """Passes a request on without its token, or answers why not."""
        if scope["type"] != "http":
            return await self._app(scope, receive, send)

        async def send_guarded(message: "Message") -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*(_HEADERS | dict(message["headers"])).items()]
            await send(message)

        token, _, rest = scope["path"].removeprefix("/").partition("/")
        request, app = Request(scope), self._app
        if why := self._access.refuse(request, token, rest):
            app = PlainTextResponse(why, 403)
        elif not self._access.knows_password(request):
            if "authorization" in request.headers:
                await asyncio.sleep(1.0)  # makes guessing slow
            ask = {"www-authenticate": 'Basic realm="maidenflight", charset="UTF-8"'}
            app = PlainTextResponse("A password is needed.", 401, ask)
        await app({**scope, "path": f"/{rest}"}, receive, send_guarded)
