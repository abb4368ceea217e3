"""The page's server: one run folder, its steps as forms, and commands that run in it."""

import asyncio
import json
import socket
import tempfile
import threading
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

import uvicorn
from markupsafe import Markup
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, Response
from starlette.routing import Route

from maidenflight import __version__, manifest, results, run_folder
from maidenflight.errors import InputError
from maidenflight.integrations.app import folder as files
from maidenflight.integrations.app import forms, jobs, steps, views
from maidenflight.integrations.app.guard import Access, Guard
from maidenflight.manifest import Manifest
from maidenflight.settings import REQUIRED

_OF_REPORT = (
    "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; img-src data:"
)
"""What the report may do: it has its scripts in itself, and no way to the page."""
_LOG = Markup('<li>{0} <button type=button name="{0}" aria-label="Remove {0}">&times;</button>')


class Page:
    """The page of a run folder: its commands, and what it answers to each request."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.jobs, self.verbs = folder.resolve(), dict[str, jobs.Job](), forms.verbs()
        self._following, self._starting = set[asyncio.Task[None]](), asyncio.Lock()
        self._scratch = tempfile.TemporaryDirectory(prefix="maidenflight-")
        self._flights = Path(self._scratch.name, run_folder.TRANSFER)

    def routes(self) -> list[Route]:
        """Returns the addresses, each with what answers."""
        return [
            Route("/", self._show),
            Route("/asset/{name}", self._send_asset),
            Route("/state", self._tell_state),
            Route("/run/{verb}", self._run, methods=["POST"]),
            Route("/cancel/{verb}", self._cancel, methods=["POST"]),
            Route("/resume/{verb}", self._resume, methods=["POST"]),
            Route("/preview", self._fly, methods=["POST"]),
            Route("/view/{verb}", self._view),
            Route("/logs/{name:path}", self._receive, methods=["PUT"]),
            Route("/logs/{name:path}", self._remove, methods=["DELETE"]),
            Route("/file/{name:path}", self._send_file),
            Route("/zip/{name:path}", self._send_archive),
        ]

    @asynccontextmanager
    async def live(self, app: Starlette) -> AsyncIterator[None]:
        """Imports what is heavy once the server is there; at its end interrupts what runs."""
        threading.Thread(target=views.asset, args=("vega.js",), daemon=True).start()
        yield
        await jobs.interrupt_all(self.jobs.values())
        await asyncio.gather(*self._following)
        self._scratch.cleanup()

    def _read(self) -> tuple[Manifest, str]:
        try:
            return manifest.read_manifest(self.folder), ""
        except InputError as error:
            return Manifest(self.folder), str(error)

    async def _show(self, request: Request) -> Response:
        about: Any = {"folder": self.folder.name or str(self.folder), "version": __version__}
        about |= {"forms": forms, "needed": REQUIRED, "verbs": self.verbs}
        names = steps.find_files(self.folder, self._read()[0])
        return HTMLResponse(views.render("page.html", files=names, **about))

    async def _send_asset(self, request: Request) -> Response:
        name = request.path_params["name"]
        text = await run_in_threadpool(views.asset, name)
        kind = "text/css" if name.endswith(".css") else "text/javascript"
        return Response(text, 200, {"cache-control": "private, max-age=86400"}, kind)

    async def _tell_state(self, request: Request) -> Response:
        run, problem = self._read()
        state = {name: self._state_of(run, name) for name in self.verbs}
        logs = "".join(_LOG.format(name) for name in files.find_logs(self.folder))
        return JSONResponse({"problem": problem, "logs": logs, "steps": state})

    def _state_of(self, run: Manifest, name: str) -> dict[str, Any]:
        job, flight = self.jobs.get(name), self.jobs.get(views.PREVIEW)
        step, running = steps.read_step(run, name, job), bool(job and job.running)
        learns = bool(job and job.scores and job.state != "done")
        live = str(job.scores[-1]["update"]) if job and learns else ""
        is_there = name in views.SECTIONS and (step.entries or (name == "log" and job))
        ended = f"{step.stamp}-{job.began if job else ''}" if is_there and not running else ""
        return {
            "state": job.state if job else "done" if step.names else "",
            "html": views.render("job.html", job=job, step=step, name=name, now=time.monotonic()),
            "view": f"view/{name}?{live or ended}" if live or ended else "",
            "live": learns,
            "flight": f"view/preview?{flight.began}" if flight and not flight.running else "",
            "flies": bool(flight and flight.running),
            "policy": bool(running and job and job.policy),
            "resumes": bool(job and job.state == "cancelled" and "--resume" in job.error),
            "filled": steps.suggest(run, self.verbs[name], self.jobs.values()),
        }

    async def _run(self, request: Request) -> Response:
        name, content = request.path_params["verb"], b""
        async for part in request.stream():
            content += part
            if len(content) > 100_000:
                raise InputError("This form holds more than a command takes.")
        try:
            filled = json.loads(content)
        except (ValueError, RecursionError):
            filled = None
        if name not in self.verbs or not isinstance(filled, dict):
            raise InputError(f"{name}: no step of this page, or no form. Reload the page.")
        check = partial(files.confine, self.folder)
        words = await run_in_threadpool(forms.words_of, self.verbs[name], filled, check)
        return await self._start(name, name, words)

    async def _start(self, key: str, verb: str, words: list[str], behind: bool = False) -> Response:
        async with self._starting:  # of two windows one is the first
            if key in self.jobs and self.jobs[key].running:
                raise InputError(f"{verb} is running, maybe of another window. Cancel it first.")
            self.jobs[key] = await jobs.start(self.folder, verb, words, behind)
        task = asyncio.create_task(self.jobs[key].follow())
        self._following.add(task)
        task.add_done_callback(self._following.discard)
        return JSONResponse({})

    async def _cancel(self, request: Request) -> Response:
        if job := self.jobs.get(request.path_params["verb"]):
            job.interrupt()
        return JSONResponse({})

    async def _resume(self, request: Request) -> Response:
        """Goes on with what was cancelled, by the same words, whatever the form holds by now."""
        name = request.path_params["verb"]
        if name not in self.jobs:
            raise InputError(f"{name}: nothing to resume.")
        words = [word for word in self.jobs[name].words if word not in ("--overwrite", "--resume")]
        return await self._start(name, name, ["--resume", *words])

    async def _fly(self, request: Request) -> Response:
        """Flies the policy that is in training as it is by now, behind the training."""
        training, policy = self.jobs.get("train"), self._flights.with_name("policy_1.json")
        if training is None or not training.policy:
            raise InputError("No policy is in training.")
        results.write(policy, training.policy)
        drones = [word for word in training.words if word.startswith("--drone=")]
        words = [*(drones or [f"--drone={run_folder.DRONE}"]), "--trials=1", "--duration=10"]
        words += ["--overwrite", f"--output={self._flights}", "--", str(policy)]
        return await self._start(views.PREVIEW, "transfer", words, behind=True)

    async def _view(self, request: Request) -> Response:
        name = request.path_params["verb"]
        headers = {"content-security-policy": _OF_REPORT} if name == "report" else {}
        known = self._read()[0], name, self.jobs.get(name), self._flights
        try:
            return HTMLResponse(await run_in_threadpool(views.view, *known), headers=headers)
        except InputError as error:
            return HTMLResponse(views.render("view.html", content=str(error), logs=""), 404)

    async def _receive(self, request: Request) -> Response:
        name, size = request.path_params["name"], request.headers.get("content-length", "0")
        known = int(size) if size.isdecimal() else files.LARGEST + 1
        try:
            there = await files.receive(self.folder, name, request.stream(), known)
        except ClientDisconnect:
            return Response(status_code=400)
        return JSONResponse({"name": there})

    async def _remove(self, request: Request) -> Response:
        files.remove_log(self.folder, request.path_params["name"])
        return JSONResponse({})

    async def _send_file(self, request: Request) -> Response:
        """Sends a file to be saved, which is never shown."""
        path = files.find_file(self.folder, request.path_params["name"])
        return FileResponse(path, filename=path.name, media_type="application/octet-stream")

    async def _send_archive(self, request: Request) -> Response:
        output = request.path_params["name"]
        entries = [entry for entry in self._read()[0].entries if entry.output == output]
        names = [name for entry in entries for ones in entry.written.values() for name in ones]
        packed = await run_in_threadpool(files.pack, self.folder, names)
        return Response(packed, media_type="application/zip")


def make_application(folder: Path, access: Access) -> Starlette:
    """Returns the page of a folder as an ASGI application."""
    page, guards = Page(folder), [Middleware(Guard, access)]
    errors = {InputError: lambda _, error: JSONResponse({"error": str(error)}, 422)}
    return Starlette(False, page.routes(), guards, errors, lifespan=page.live)


def serve(folder: Path, access: Access, listening: socket.socket) -> None:
    """Serves the page of a folder at a socket until it is interrupted."""
    options: Any = {"log_level": "error", "access_log": False, "server_header": False}
    options |= {"timeout_graceful_shutdown": 2, "lifespan": "on"}
    config = uvicorn.Config(make_application(folder, access), **options)
    uvicorn.Server(config).run(sockets=[listening])
