"""The lab in a browser: who is let in, and one that really runs. ``NETLAB_SCREENSHOTS=DIR`` keeps the picture."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable
from pathlib import Path

import numpy as np
import pytest
from aiohttp import ClientSession, CookieJar, WSServerHandshakeError, web
from matplotlib.image import imread

from netlab.cli import main
from netlab.tui.web import LabServer, listen
from tests.report.headless_browser import Browser, chromium

Visit = Callable[[ClientSession, LabServer, str], Awaitable[None]]
# A lab that is up as long as the file is there; it ends when it is told to quit, as Textual's web driver does.
LAB = """
import sys, pathlib
up = pathlib.Path(sys.argv[1]); up.touch()
sys.stdout.write("__GANGLION__\\n"); sys.stdout.flush()
sys.stdout.buffer.write(b"D\\0\\0\\0\\5hello"); sys.stdout.flush()
while b"quit" not in sys.stdin.buffer.read1(): pass
up.unlink()
"""
FRAME = "new Promise(done => requestAnimationFrame(() => done(true)))"
CLOSED = "document.body.classList.contains('-closed')"
_ANSWER_S = 60.0


def visit(script: Visit, *argv: str) -> None:
    """Serve, and let the script be a browser that has no cookie yet."""

    async def run() -> None:
        with listen(0) as sock:
            server = LabServer([sys.executable, "-c", LAB, *argv], sock.getsockname()[1])
            runner = web.AppRunner(server.application())
            await runner.setup()
            await web.SockSite(runner, sock).start()
            try:
                async with ClientSession(cookie_jar=CookieJar(unsafe=True)) as client:  # unsafe: an address has no name
                    await script(client, server, server.gate.url.partition("/?")[0])
            finally:
                await runner.cleanup()

    asyncio.run(run())


async def status(client: ClientSession, url: str, **headers: str) -> int:
    async with client.get(url, headers=headers, allow_redirects=False) as answer:
        return answer.status


async def refused(client: ClientSession, url: str, **headers: str) -> int:
    with pytest.raises(WSServerHandshakeError) as caught:
        await client.ws_connect(f"{url}/ws", headers=headers)
    return caught.value.status


def test_token_is_exchanged_for_a_cookie_once() -> None:
    async def script(client: ClientSession, server: LabServer, url: str) -> None:
        assert await status(client, f"{url}/?token=guessed") == 403
        assert await status(client, f"{url}/?token=%C3%A9") == 403
        async with client.get(server.gate.url, allow_redirects=False) as answer:
            assert (answer.status, answer.headers["Location"]) == (303, "/")
            for word in ("HttpOnly", "SameSite=Strict", "Path=/"):
                assert word in answer.headers["Set-Cookie"]
        assert await status(client, f"{url}/") == 200
        async with ClientSession() as other:
            assert await status(other, server.gate.url) == 403

    visit(script)


def test_without_the_cookie_nothing_is_served() -> None:
    async def script(client: ClientSession, server: LabServer, url: str) -> None:
        paths = ("/", "/static/js/textual.js", "/download/x", "/elsewhere")
        assert [await status(client, url + path) for path in paths] == [403] * 4
        assert await refused(client, url, Origin=url) == 403
        assert await status(client, server.gate.url) == 303
        assert [await status(client, url + path) for path in paths] == [200, 200, 404, 404]

    visit(script)


def test_another_host_name_is_refused_even_with_the_token() -> None:
    async def script(client: ClientSession, server: LabServer, url: str) -> None:
        assert await status(client, server.gate.url, Host="rebound.example") == 403
        assert await status(client, server.gate.url) == 303
        assert await status(client, url, Host="rebound.example") == 403
        port = url.rpartition(":")[2]
        assert await status(client, url, Host=f"localhost:{port}") == 200

    visit(script)


def test_websocket_of_another_page_is_refused() -> None:
    async def script(client: ClientSession, server: LabServer, url: str) -> None:
        assert await status(client, server.gate.url) == 303
        assert await refused(client, url, Origin="http://elsewhere.example") == 403
        assert await refused(client, url) == 403

    visit(script)


def test_page_may_load_nothing_from_elsewhere() -> None:
    async def script(client: ClientSession, server: LabServer, url: str) -> None:
        async with client.get(server.gate.url) as answer:
            assert "default-src 'self'" in answer.headers["Content-Security-Policy"]
            page = (await answer.text()).replace(url.replace("http", "ws"), "")
            assert "//" not in page

    visit(script)


def test_lab_goes_down_with_its_page_and_the_next_waits_for_that(tmp_path: Path) -> None:
    up = tmp_path / "up"

    async def script(client: ClientSession, server: LabServer, url: str) -> None:
        assert await status(client, server.gate.url) == 303
        page = await client.ws_connect(f"{url}/ws", headers={"Origin": url})
        assert await page.receive_bytes() == b"hello"
        assert up.exists()
        waiting = asyncio.create_task(client.ws_connect(f"{url}/ws", headers={"Origin": url}))
        assert not (await asyncio.wait({waiting}, timeout=0.2))[0]
        await page.close()
        again = await waiting
        assert await again.receive_bytes() == b"hello"
        ending = server.on_shutdown(web.Application())  # while that page is open
        await asyncio.wait_for(asyncio.gather(again.receive(), ending), _ANSWER_S)
        assert not up.exists()

    visit(script, str(up))


def until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + _ANSWER_S
    while not condition():
        assert time.monotonic() < deadline, "this never came"


def picture_of(browser: Browser, target: Path) -> Path:
    browser.picture(target, whole=False)
    return target


def colours(picture: Path) -> int:
    pixels = imread(picture)
    return len(np.unique(pixels.reshape(-1, pixels.shape[-1]), axis=0))


@pytest.mark.skipif(chromium() is None, reason="no chromium")
def test_a_browser_shows_the_map_and_asks_nobody_else(tmp_path: Path) -> None:
    program = chromium()
    assert program is not None
    picture = Path(os.environ.get("NETLAB_SCREENSHOTS", tmp_path)) / "web.png"
    command = [sys.executable, "-m", "netlab", "lab", "topologies/pair.yaml", "--web"]
    command += ["--set", "duration=120s", "--capture", str(tmp_path / "pair.mcap")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as lab:
        try:
            assert lab.stdout is not None
            url = lab.stdout.readline().split()[-1]
            with Browser(program) as browser:
                browser.show(url, width=1280, height=760)
                words = (b"base", b"robot1", b"priority 1")
                until(lambda: browser.ask(FRAME) and all(word in browser.received for word in words))
                assert browser.ask("getComputedStyle(document.querySelector('.begins')).display") == "none"
                until(lambda: colours(picture_of(browser, picture)) > 20)  # what came is drawn a moment later
                address = url.partition("/?")[0].partition("//")[2]
                assert {asked.split("/")[2] for asked in browser.requested} == {address}
                lab.send_signal(signal.SIGINT)
                until(lambda: browser.ask(CLOSED))
            said = lab.communicate(timeout=_ANSWER_S)[0]
        finally:
            lab.kill()
    assert lab.returncode == 0
    assert "pair.mcap" in said
    assert "Traceback" not in said


def test_what_cannot_be_served_is_said_before_anything_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def said(*words: str) -> tuple[object, str]:
        with pytest.raises(SystemExit) as ended:
            main(["lab", *words])
        return ended.value.code, capsys.readouterr().err

    assert said("--web", "65536")[0] == 2
    assert said("--web", "0", "--plain")[0] == 2
    assert "nowhere.yaml" in said("nowhere.yaml", "--web")[1]
    with listen(0) as taken:
        port = taken.getsockname()[1]
        assert f"127.0.0.1:{port}" in said("topologies/pair.yaml", "--web", str(port))[1]
    monkeypatch.setattr("netlab.cli.lab.importlib.util.find_spec", lambda _name: None)
    assert "udp-mesh-lab[web]" in said("topologies/pair.yaml", "--web")[1]
