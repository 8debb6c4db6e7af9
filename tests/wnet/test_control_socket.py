"""The daemon's Unix socket, with both ends in one process."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from udp_mesh.io.local_socket import SocketInUse
from wnet.io.control import ControlError, ControlServer, ask


@contextlib.contextmanager
def serving(path: str, answer: Any) -> Iterator[ControlServer]:
    """A server whose loop runs in a thread until the end of the block."""
    server = ControlServer(path, answer)
    ended = threading.Event()

    def loop() -> None:
        while not ended.is_set():
            server.accept()
            for asking in list(server.asking):
                with contextlib.suppress(BlockingIOError):
                    if asking.recv(1, socket.MSG_PEEK):
                        server.answer(asking.fileno())

    thread = threading.Thread(target=loop)
    thread.start()
    try:
        yield server
    finally:
        ended.set()
        thread.join()
        server.close()


def test_a_question_is_answered_and_a_wrong_one_refused(tmp_path: Path) -> None:
    path = str(tmp_path / "s")
    with serving(path, lambda word: {"word": word, "rows": ["x" * 100] * 5000}):
        told = ask(path, "links")
        assert (told["word"], len(told["rows"])) == ("links", 5000)
        with pytest.raises(ControlError, match="there is no question 'secrets'"):
            ask(path, "secrets")
        assert Path(path).stat().st_mode & 0o077 == 0, "its owner's alone"
        with pytest.raises(SocketInUse, match="another daemon serves"):
            ControlServer(path, dict)
    with pytest.raises(ControlError, match=r"no daemon at .*: No such file"):
        ask(path, "links")


def test_the_socket_of_a_daemon_that_was_killed_is_replaced(tmp_path: Path) -> None:
    path = str(tmp_path / "s")
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(path)
    with serving(path, lambda word: {"word": word}):
        assert ask(path, "routes") == {"word": "routes"}


def test_a_file_is_never_replaced(tmp_path: Path) -> None:
    file = tmp_path / "s"
    file.write_text("mine")
    with pytest.raises(SocketInUse, match="is there and no socket"):
        ControlServer(str(file), dict)
    assert file.read_text() == "mine"


def test_one_who_connects_and_says_nothing_holds_nobody_up(tmp_path: Path) -> None:
    path = str(tmp_path / "s")
    with serving(path, lambda word: {"word": word}), contextlib.ExitStack() as stack:
        for _ in range(30):
            silent = stack.enter_context(socket.socket(socket.AF_UNIX))
            silent.connect(path)
        assert ask(path, "links") == {"word": "links"}
