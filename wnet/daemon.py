"""The daemon process: arguments, signals, exit codes. Importing it does nothing."""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import sys
import time
from collections.abc import Sequence

from udp_mesh.io.local_socket import SocketInUse
from udp_mesh.io.process import allow_exact_timers, stopped_by_signals, tell_ready
from wnet.config import ConfigError
from wnet.core.mesh import Mesh
from wnet.daemon_config import DaemonConfig, load
from wnet.io.control import ControlServer, default_socket
from wnet.io.feed import EventFeed
from wnet.io.members import open_port
from wnet.io.mesh_interface import InterfaceDeleted, open_mesh_interface
from wnet.io.node import Node
from wnet.views import answer

EXIT_BAD_ENVIRONMENT = 2
_EPOCH_BITS = 32
_HIGHEST_PRIORITY = -20


def main(argv: Sequence[str]) -> int:
    """Run the daemon until SIGTERM or SIGINT; return the exit code: 0, or 2 with one line that says why."""
    arguments = _parser().parse_args(argv)
    try:
        return _serve(load(arguments.config), arguments)
    except ConfigError as error:
        return _fail("\n".join(error.problems))
    except SocketInUse as error:
        return _fail(str(error))
    except InterfaceDeleted:
        return _fail("the mesh interface was deleted; nothing is left to route for")
    except PermissionError as error:
        return _fail(f"{error.strerror}; packet sockets need CAP_NET_RAW, and making interfaces CAP_NET_ADMIN")
    except OSError as error:
        return _fail(error.strerror or str(error))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="wnet daemon", description="Make this node a part of the mesh.")
    parser.add_argument("--config", metavar="FILE", required=True, help="TOML file")
    parser.add_argument("--ready-fd", type=int, metavar="N", help="write READY=1 here when all interfaces are open")
    parser.add_argument("--events-fd", type=int, metavar="N", help="write events here, one JSON object a line")
    parser.add_argument("--seed", metavar="TEXT", help="of the jitter, so that a run can be repeated")
    return parser


def _fail(text: str) -> int:
    print(f"wnet: {text}", file=sys.stderr)
    return EXIT_BAD_ENVIRONMENT


def _serve(config: DaemonConfig, arguments: argparse.Namespace) -> int:
    _be_prompt()
    with contextlib.ExitStack() as stack:
        ports = []
        for member in config.members:
            rates_bps, mac = member.rates_bps, member.mac
            ports.append(open_port(member.interface, is_radio=member.radio, rates_bps=rates_bps, mac=mac))
            stack.callback(ports[-1].close)
        interface, mac = open_mesh_interface(config.interface, config.address, config.mtu_bytes)
        stack.callback(interface.close)
        mesh = Mesh(
            config.mesh,
            mac,
            [port.member for port in ports],
            epoch=random.SystemRandom().getrandbits(_EPOCH_BITS),  # never seeded: it tells this start from every other
            rng=random.Random(arguments.seed),
            now=time.monotonic(),
        )
        control = ControlServer(
            config.socket or default_socket(), lambda word: answer(word, mesh.snapshot(now=time.monotonic()))
        )
        feed = None if arguments.events_fd is None else EventFeed(arguments.events_fd, mac)
        node = Node(mesh, ports, interface, config.interface, control, feed)
        stack.pop_all()
    try:
        with stopped_by_signals(node):
            tell_ready(arguments.ready_fd)
            node.run()
    finally:
        node.close()
    return 0


def _be_prompt() -> None:
    """Exact timers, and the highest ordinary priority where it may be had: all the node's traffic waits for this."""
    allow_exact_timers()
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, _HIGHEST_PRIORITY)
