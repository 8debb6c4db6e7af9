"""The daemon process: arguments, signals, exit codes. Importing it does nothing."""

from __future__ import annotations

import argparse
import contextlib
import errno
import os
import random
import socket
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from udp_mesh.config import Config, ConfigError, default_socket, load
from udp_mesh.core.mesh import MeshCore, new_epoch
from udp_mesh.io.feed import EventFeed
from udp_mesh.io.local_socket import SocketInUse
from udp_mesh.io.node import Node
from udp_mesh.io.process import allow_exact_timers, stopped_by_signals, tell_ready
from udp_mesh.io.server import LocalServer

EXIT_BAD_ENVIRONMENT = 2


def main(argv: Sequence[str]) -> int:
    """Run the daemon until SIGTERM or SIGINT; return the exit code: 0, or 2 with one line that says why."""
    arguments = _parser().parse_args(argv)
    try:
        config = load(arguments.config) if arguments.config else Config()
        return _serve(config, arguments)
    except ConfigError as error:
        return _fail("\n".join(error.problems))
    except SocketInUse as error:
        return _fail(str(error))
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            return _fail(f"UDP port {config.port} is in use; end the other daemon or choose another port")
        return _fail(f"cannot open the network: {error.strerror or error}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="udp-mesh daemon", description="Connect this node to the team.")
    parser.add_argument("--config", metavar="FILE", help="TOML file; without it everything has its default")
    parser.add_argument("--ready-fd", type=int, metavar="N", help="write READY=1 here when all sockets are open")
    parser.add_argument("--events-fd", type=int, metavar="N", help="write events here, one JSON object a line")
    parser.add_argument("--trace-fragments", action="store_true", help="report every fragment sent as an event")
    parser.add_argument("--seed", metavar="TEXT", help="of the beacons' jitter, so that a run can be repeated")
    return parser


def _fail(text: str) -> int:
    print(f"udp-mesh: {text}", file=sys.stderr)
    return EXIT_BAD_ENVIRONMENT


def _serve(config: Config, arguments: argparse.Namespace) -> int:
    allow_exact_timers()
    core = MeshCore(
        config.settings(trace_fragments=arguments.trace_fragments),
        epoch=new_epoch(random.SystemRandom()),  # never seeded: it tells this start from every other
        rng=random.Random(arguments.seed),
        now=time.monotonic(),
    )
    path = config.socket or default_socket()
    server = LocalServer(path)
    feed = None if arguments.events_fd is None else EventFeed(arguments.events_fd)
    node = Node(replace(config, socket=path), core, server, feed)
    try:
        node.open_carriers()
        for device in (carrier.device for carrier in config.carriers if carrier.device):
            if not Path(device).exists():
                print(f"udp-mesh: {device} is not there; it is used once it is", file=sys.stderr, flush=True)
        node.open_store()
        with stopped_by_signals(node):
            tell_ready(arguments.ready_fd)
            tell_systemd("READY=1")
            node.run()
    finally:
        node.close()
    return 0


def tell_systemd(state: str) -> None:
    """Report to the service manager that started this process, if one did; see sd_notify(3)."""
    path = os.environ.get("NOTIFY_SOCKET", "")
    if not path:
        return
    address = "\0" + path[1:] if path.startswith("@") else path
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.sendto(state.encode(), address)
