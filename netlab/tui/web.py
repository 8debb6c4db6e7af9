"""The interactive lab in a browser of this machine: textual-serve on 127.0.0.1, for whoever was given the URL only.

The URL's token works once and is exchanged for a cookie, without which nothing is served. The Host header is checked
against DNS rebinding, the Origin of the websocket against other pages, and the page may load nothing from elsewhere.
"""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import shlex
import socket
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path

from aiohttp import web
from textual_serve.app_service import AppService
from textual_serve.server import Server, to_int

from netlab.errors import LabError

_ADDRESS = "127.0.0.1"
_HEARTBEAT_S = 15.0  # a browser that vanished without a word is noticed by then
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "connect-src 'self' ws://{host}; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class Gate:
    """Lets in the browser that has the token, and nobody else.

    Attributes:
        url: What to open; works once.
    """

    def __init__(self, port: int) -> None:
        """``port``: where the server listens."""
        self._hosts = (f"{_ADDRESS}:{port}", f"localhost:{port}")
        self._cookie = f"netlab-{port}"  # browsers send a cookie to all ports of a host
        self._secret = secrets.token_urlsafe()
        self._token: str | None = secrets.token_urlsafe()
        self.url = f"http://{self._hosts[0]}/?token={self._token}"

    @web.middleware
    async def check(
        self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        """Serve the request, exchange its token for the cookie, or refuse it with 403."""
        if request.host not in self._hosts:
            raise web.HTTPForbidden(text=f"this lab is at {self._hosts[0]}")
        if request.path == "/" and request.method == "GET" and self._take(request.query.get("token")):
            answer = web.Response(status=web.HTTPSeeOther.status_code, headers={"Location": "/"})
            answer.set_cookie(self._cookie, self._secret, httponly=True, samesite="Strict", path="/")
            return answer
        if not _same(request.cookies.get(self._cookie), self._secret):
            raise web.HTTPForbidden(text="open the URL that `netlab lab --web` printed; it works once, in one browser")
        if request.path == "/ws" and request.headers.get("Origin") != f"http://{request.host}":
            raise web.HTTPForbidden(text="only the lab's own page may connect")
        return await handler(request)

    def _take(self, token: str | None) -> bool:
        fits = _same(token, self._token)
        if fits:
            self._token = None
        return fits


def _same(told: str | None, known: str | None) -> bool:
    return told is not None and known is not None and secrets.compare_digest(told.encode(), known.encode())


class _LabProcess(AppService):
    """The interactive lab of one page; stopped once its process has ended."""

    async def on_data(self, payload: bytes) -> None:
        with contextlib.suppress(
            ConnectionResetError
        ):  # the page is gone: read on, else the process blocks on its pipe
            await super().on_data(payload)

    async def stop(self) -> None:
        await super().stop()
        if self._process is not None:
            await self._process.wait()


class LabServer(Server):
    """Serves the page. A page is a run of the lab, which goes down with it; another page waits until it is down."""

    def __init__(self, argv: Sequence[str], port: int) -> None:
        """``argv``: the command that is the interactive lab. ``port``: where the server listens."""
        super().__init__(f"exec {shlex.join(argv)}", _ADDRESS, port)
        self.gate = Gate(port)
        self._page = Path(__file__).with_name("web.html").read_text()
        self._turn = asyncio.Lock()
        self._sessions = set[asyncio.Task[object]]()

    def application(self) -> web.Application:
        """All that is served, behind the gate."""
        app = web.Application(middlewares=[self.gate.check])
        app.router.add_get("/", self.index)
        app.router.add_get("/ws", self.handle_websocket)
        app.router.add_get("/download/{key}", self.handle_download)
        app.router.add_static("/static", self.statics_path)
        app.on_response_prepare.append(_add_headers)
        app.on_shutdown.append(self.on_shutdown)
        return app

    async def index(self, request: web.Request) -> web.Response:
        """The page."""
        return web.Response(text=self._page.replace("{{host}}", request.host), content_type="text/html")

    async def handle_websocket(self, request: web.Request) -> web.WebSocketResponse:
        """Run a lab for as long as the page is there."""
        task = asyncio.current_task()
        assert task is not None
        self._sessions.add(task)
        try:
            async with self._turn:
                return await self._run_lab(request)
        finally:
            self._sessions.discard(task)

    async def _run_lab(self, request: web.Request) -> web.WebSocketResponse:
        if request.transport is None:  # closed while it waited for its turn
            raise web.HTTPGone
        page = web.WebSocketResponse(heartbeat=_HEARTBEAT_S)
        await page.prepare(request)
        lab = _LabProcess(
            self.command,
            write_bytes=page.send_bytes,
            write_str=page.send_str,
            close=page.close,  # type: ignore[arg-type]  # what it returns is not looked at
            download_manager=self.download_manager,
        )
        try:
            await lab.start(
                *(to_int(request.query.get(key, ""), size) for key, size in (("width", 80), ("height", 24)))
            )
            await self._process_messages(page, lab)
        finally:
            await lab.stop()
            await page.close()
        return page

    async def on_shutdown(self, app: web.Application) -> None:
        """End every lab, and wait until it has ended."""
        sessions = list(self._sessions)
        for session in sessions:
            session.cancel()
        await asyncio.gather(*sessions, return_exceptions=True)


async def _add_headers(request: web.Request, response: web.StreamResponse) -> None:
    response.headers.update({name: value.replace("{host}", request.host) for name, value in _HEADERS.items()})


def listen(port: int) -> socket.socket:
    """A socket on this machine's own address; port 0 is any free one.

    Raises:
        LabError: The port is taken.
    """
    try:
        return socket.create_server((_ADDRESS, port))
    except OSError as error:
        raise LabError(
            f"cannot listen on {_ADDRESS}:{port}: {error.strerror}; --web without a port takes a free one"
        ) from None


def serve(argv: Sequence[str], port: int, *, announce: Callable[[str], None]) -> None:
    """Serve the interactive lab that ``argv`` runs until Ctrl-C; ``announce`` is told the URL.

    Raises:
        LabError: The port is taken.
    """
    with listen(port) as sock:
        server = LabServer(argv, sock.getsockname()[1])
        announce(server.gate.url)
        web.run_app(server.application(), sock=sock, print=None, access_log=None)
