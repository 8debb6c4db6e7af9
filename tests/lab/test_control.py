"""The control socket between a command and a supervisor, both ends real, on one event loop."""

from __future__ import annotations

import asyncio
import json
import os
import socket
from pathlib import Path

import pytest

from netlab.errors import LabError
from netlab.lab.control import Connection, ControlClient, ControlServer, Reply, Request


async def _handler(request: Request, fds: list[int], connection: Connection) -> Reply | None:
    if request["do"] == "fail":
        raise LabError("no such node")
    if request["do"] == "read":
        return {"text": os.read(fds[0], 100).decode()}
    if request["do"] == "twice":
        connection.send({"n": 1})
        connection.send({"n": 2})
        return None
    return {"echo": request}


def _with_server(path: Path, client: object) -> object:
    async def main() -> object:
        server = ControlServer(path, _handler)
        try:
            return await asyncio.to_thread(client)  # type: ignore[arg-type]
        finally:
            server.close()

    return asyncio.run(main())


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "control"


def test_a_request_gets_its_answer(path: Path) -> None:
    def client() -> Reply:
        connection = ControlClient(path)
        reply = connection.request({"do": "status", "x": [1, "ü"]})
        connection.close()
        return reply

    assert _with_server(path, client) == {"echo": {"do": "status", "x": [1, "ü"]}}


def test_a_refusal_arrives_as_the_same_text(path: Path) -> None:
    def client() -> None:
        connection = ControlClient(path)
        with pytest.raises(LabError, match="no such node"):
            connection.request({"do": "fail"})
        connection.close()

    _with_server(path, client)


def test_several_answers_and_descriptors(path: Path) -> None:
    def client() -> list[object]:
        connection = ControlClient(path)
        read, write = os.pipe()
        os.write(write, b"through the pipe")
        text = connection.request({"do": "read"}, [read])["text"]
        numbers = [connection.request({"do": "twice"})["n"], connection.next_reply()["n"]]
        os.close(read)
        os.close(write)
        connection.close()
        return [text, numbers]

    assert _with_server(path, client) == ["through the pipe", [1, 2]]


@pytest.mark.parametrize("data", [b"not json", b"[]", b"{}", b'{"do": 1}'])
def test_a_bad_request_is_answered_and_the_server_lives_on(path: Path, data: bytes) -> None:
    def client() -> Reply:
        raw = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        raw.connect(str(path))
        raw.send(data)
        first: Reply = json.loads(raw.recv(4096))
        raw.send(b'{"do": "status"}')
        second: Reply = json.loads(raw.recv(4096))
        raw.close()
        assert "echo" in second
        return first

    reply = _with_server(path, client)
    assert isinstance(reply, dict)
    assert "error" in reply or "echo" in reply


def test_only_the_owner_may_open_it(path: Path) -> None:
    assert _with_server(path, lambda: path.stat().st_mode & 0o777) == 0o600


def test_a_missing_lab_is_said_plainly(path: Path) -> None:
    with pytest.raises(LabError, match="does not answer"):
        ControlClient(path)
