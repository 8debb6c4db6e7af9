"""The Unix socket on which the daemon answers ``wnet topology|links|routes``: one word in, one JSON object out.

A connection is one question: a line, then its answer to the end of the stream. Nobody holds the daemon up: it waits for
no question, and not for long for an answer to be taken.
"""

from __future__ import annotations

import contextlib
import json
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

from udp_mesh.io.local_socket import default_path, listen

_QUESTION_BYTES_MAX = 64
_ANSWER_WAIT_S = 5.0
_BACKLOG = 128
_PATIENCE_S = 0.05  # with one who reads slowly
_ASKING_MAX = 16
QUESTIONS = ("topology", "links", "routes", "stats")


class ControlError(Exception):
    """No daemon, or it did not answer."""


def default_socket() -> str:
    """Return $WNET_SOCKET, or /run/wnet.sock where that can be written, or one in the user's runtime folder."""
    return default_path("wnet")


class ControlServer:
    """The daemon's side; the loop calls :meth:`accept` and :meth:`answer` when a descriptor is readable."""

    def __init__(self, path: str, answer: Callable[[str], dict[str, Any]]) -> None:
        """``answer`` gives the object for a word of :data:`QUESTIONS`.

        Raises:
            SocketInUse: Another daemon serves ``path``, or it cannot be made there.
        """
        self._path = path
        self._answer = answer
        self.asking: list[socket.socket] = []
        self._socket = listen(path, backlog=_BACKLOG)

    def fileno(self) -> int:
        """Readable when somebody connects."""
        return self._socket.fileno()

    def accept(self) -> None:
        """Take a connection; its question comes when it is readable. The oldest goes where there are too many."""
        with contextlib.suppress(OSError):
            self.asking.append(self._socket.accept()[0])
            self.asking[-1].setblocking(False)
        if len(self.asking) > _ASKING_MAX:
            self.asking.pop(0).close()

    def answer(self, descriptor: int) -> None:
        """Read the question that has come on one of ``asking``, and answer it."""
        asking = next((one for one in self.asking if one.fileno() == descriptor), None)
        if asking is None:
            return
        self.asking.remove(asking)
        with asking, contextlib.suppress(OSError):
            word = asking.recv(_QUESTION_BYTES_MAX).decode("ascii", "replace").strip()
            if not word:
                return
            told = self._answer(word) if word in QUESTIONS else {"error": f"there is no question '{word}'"}
            asking.settimeout(_PATIENCE_S)
            asking.sendall(json.dumps(told).encode() + b"\n")

    def close(self) -> None:
        """Stop, and remove the socket."""
        for asking in self.asking:
            asking.close()
        self._socket.close()
        with contextlib.suppress(OSError):
            Path(self._path).unlink()


def ask(path: str, word: str, *, timeout_s: float = _ANSWER_WAIT_S) -> dict[str, Any]:
    """Ask a daemon.

    Raises:
        ControlError: There is none, or its answer makes no sense.
    """
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as sock:
            sock.settimeout(timeout_s)
            sock.connect(path)
            sock.sendall(word.encode() + b"\n")
            data = b"".join(iter(lambda: sock.recv(1 << 16), b""))
        answer = json.loads(data)
    except TimeoutError:
        raise ControlError(f"the daemon at {path} did not answer within {timeout_s:g} s") from None
    except OSError as error:
        raise ControlError(
            f"no daemon at {path}: {error.strerror}; start one with: wnet daemon --config FILE"
        ) from error
    except ValueError:
        raise ControlError(f"the daemon at {path} gave no answer; a frame storm may keep it busy, try again") from None
    if not isinstance(answer, dict) or "error" in answer:
        raise ControlError(str(answer.get("error", answer) if isinstance(answer, dict) else answer))
    return answer
