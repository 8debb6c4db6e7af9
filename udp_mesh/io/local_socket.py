"""Where the programs of a node find a daemon: the path of its Unix socket, and listening there. For all our daemons."""

from __future__ import annotations

import contextlib
import os
import socket
import stat
from pathlib import Path

_MODE = 0o600


class SocketInUse(Exception):
    """Another daemon serves this path, or it cannot be listened at; says which and what to do."""


def default_path(program: str) -> str:
    """Return $PROGRAM_SOCKET, or /run/program.sock where that can be written, or one in the user's runtime folder."""
    chosen = os.environ.get(f"{program.upper()}_SOCKET")
    if chosen:
        return chosen
    system, user = f"/run/{program}.sock", os.environ.get("XDG_RUNTIME_DIR")
    if Path(system).exists() or os.access("/run", os.W_OK) or not user:
        return system
    return f"{user}/{program}.sock"


def listen(path: str, *, backlog: int) -> socket.socket:
    """Return a stream socket that listens at ``path`` and never blocks; only this user may connect.

    Raises:
        SocketInUse: Another daemon answers there, or it cannot be made.
    """
    _remove_stale(path)
    listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC)
    try:
        listening.bind(path)
        Path(path).chmod(_MODE)
        listening.listen(backlog)
    except OSError as error:
        listening.close()
        raise SocketInUse(f"{path}: cannot listen here: {error.strerror or error}") from error
    return listening


def _remove_stale(path: str) -> None:
    """Remove the socket of a daemon that was killed; nobody answers there."""
    with contextlib.suppress(OSError):  # what is wrong with the path, binding it will tell
        if not stat.S_ISSOCK(Path(path).stat().st_mode):
            raise SocketInUse(f"{path} is there and no socket; choose another path with socket = ...")
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            try:
                probe.connect(path)
            except OSError:
                Path(path).unlink()
                return
        raise SocketInUse(f"{path}: another daemon serves this socket; end it, or choose another with socket = ...")
