"""The command ``wnet``. Every command parses, asks the daemon, prints."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence

from udp_mesh.io.process import ending_quietly

_VIEWS = {
    "topology": "print all links of the mesh that this node knows",
    "links": "print this node's own links",
    "routes": "print where frames of this node leave to",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; return 0, 1 (no daemon) or 2 (wrong use, or the daemon could not start)."""
    words = list(sys.argv[1:] if argv is None else argv)
    if words[:1] == ["daemon"]:
        from wnet.daemon import main as daemon  # the daemon pays for no client code, and the clients for no daemon

        return daemon(words[1:])
    arguments = _parser().parse_args(words)
    if arguments.command == "key":
        from udp_mesh.core.keys import KEY_BYTES

        print(os.urandom(KEY_BYTES).hex())
        return 0
    from wnet.io.control import ControlError, ask, default_socket

    with ending_quietly():
        try:
            told = ask(arguments.socket or default_socket(), arguments.command, timeout_s=arguments.timeout)
            print(_text(arguments, told), flush=True)
        except ControlError as error:
            print(f"wnet: {error}", file=sys.stderr)
            return 1
    return 0


def _text(arguments: argparse.Namespace, told: dict[str, object]) -> str:
    from wnet.views import dot, table

    if arguments.command == "stats" or arguments.json:
        return json.dumps(told, indent=None if arguments.json else 2)
    return dot(arguments.command, told) if arguments.dot else table(arguments.command, told)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="wnet", description="A layer-2 mesh that routes by link quality.")
    parser.add_argument("--socket", metavar="PATH", help="the daemon's Unix socket")
    parser.add_argument("--timeout", type=float, default=5.0, metavar="S", help="how long to wait for the daemon")
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("key", help="print a new key for a team's configuration")
    commands.add_parser("daemon", help="make this node a part of the mesh; daemon --help for its options")
    for word, text in _VIEWS.items():
        view = commands.add_parser(word, help=text)
        form = view.add_mutually_exclusive_group()
        form.add_argument("--json", action="store_true")
        form.add_argument("--dot", action="store_true", help="as a graph, for Graphviz")
    stats = commands.add_parser("stats", help="print counters and queues")
    stats.add_argument("--json", action="store_true", help="in one line")
    return parser
