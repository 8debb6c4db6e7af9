"""The command ``udp-mesh``. Every command parses, asks the daemon, prints."""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from udp_mesh.core.keys import KEY_BYTES
from udp_mesh.core.peer_status import PathStatus
from udp_mesh.io.process import ending_quietly

if TYPE_CHECKING:
    from udp_mesh.client import Client, Fate, PublishOptions

_CLEAR_SCREEN = "\x1b[2J\x1b[H"


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; return 0, 1 (refused, no daemon) or 2 (wrong use)."""
    words = list(sys.argv[1:] if argv is None else argv)
    if words[:1] == ["daemon"]:
        from udp_mesh.daemon import main as daemon  # the daemon pays for no client code, and the clients for no daemon

        return daemon(words[1:])
    arguments = _parser().parse_args(words)
    if arguments.command == "key":
        print(os.urandom(KEY_BYTES).hex())
        return 0
    from udp_mesh.client import Client, ClientError

    with ending_quietly():
        try:
            with Client(arguments.socket, connect_timeout_s=arguments.timeout) as client:
                return _COMMANDS[arguments.command](client, arguments)
        except ClientError as error:
            print(f"udp-mesh: {error}", file=sys.stderr)
            return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="udp-mesh", description="Messaging between robots over plain UDP.")
    parser.add_argument("--socket", metavar="PATH", help="the daemon's Unix socket")
    parser.add_argument("--timeout", type=float, default=5.0, metavar="S", help="how long to wait for the daemon")
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("key", help="print a new key for a team's configuration")
    commands.add_parser("daemon", help="connect this node to the team; daemon --help for its options")
    publish = commands.add_parser("pub", help="send one message")
    publish.add_argument("topic")
    publish.add_argument("payload", nargs="?", help="text; without it, standard input as it is")
    publish.add_argument("--to", default="all", help="a node's name, or all (default)")
    publish.add_argument("--priority", type=int, help="0..255, lower is more urgent")
    publish.add_argument("--offline", choices=["discard", "latest", "store"], help="if the node is absent")
    publish.add_argument("--lifetime", type=_positive, metavar="S", help="give it up after so long")
    publish.add_argument(
        "--wait", action="store_true", help="wait, at most --timeout, and print what became of it at each node"
    )
    ask = commands.add_parser("ask", help="send a question to one node and print the answer")
    ask.add_argument("topic")
    ask.add_argument("payload", nargs="?", default="")
    ask.add_argument("--to", required=True, help="a node's name")
    subscribe = commands.add_parser("sub", help="print messages; * is every topic")
    subscribe.add_argument("topic")
    subscribe.add_argument("--count", type=int, default=0, help="end after so many messages")
    subscribe.add_argument("--raw", action="store_true", help="write payloads as they are, nothing else")
    peers = commands.add_parser("peers", help="list the nodes that were heard")
    peers.add_argument("--json", action="store_true")
    stats = commands.add_parser("stats", help="print counters, queues and peers")
    stats.add_argument("--json", action="store_true", help="the only form for now")
    top = commands.add_parser("top", help="show peers and queues, again and again")
    top.add_argument("--interval", type=float, default=1.0, metavar="S")
    top.add_argument("--count", type=int, default=0, help="end after so many screens")
    metrics = commands.add_parser("metrics", help="print metrics for Prometheus, or serve them")
    metrics.add_argument("--listen", metavar="HOST:PORT", help="serve /metrics there until ended, as 127.0.0.1:9870")
    config = commands.add_parser("config", help="read or change settings while the daemon runs")
    config.add_argument("action", choices=["get", "set"])
    config.add_argument("key", nargs="?", help="like window, or topics.telemetry.priority")
    config.add_argument("value", nargs="?")
    return parser


def _positive(text: str) -> float:
    value = float(text)
    if not value > 0:
        raise argparse.ArgumentTypeError("has to be above 0")
    return value


def _publish(client: Client, arguments: argparse.Namespace) -> int:
    payload = sys.stdin.buffer.read() if arguments.payload is None else arguments.payload.encode()
    options: PublishOptions = {
        "priority": arguments.priority,
        "offline": arguments.offline,
        "lifetime_s": arguments.lifetime,
    }
    if not arguments.wait:
        client.publish_wait(arguments.topic, payload, to=arguments.to, timeout_s=arguments.timeout, **options)
        return 0
    delivery = client.publish_tracked(arguments.topic, payload, to=arguments.to, **options)
    delivery.wait(arguments.timeout)
    fates = delivery.fates
    for peer in delivery.peers or (arguments.to,):
        fate = fates.get(peer)
        print(f"{peer} {f'no word within {arguments.timeout:g} s' if fate is None else _fate_text(fate)}")
    return 0 if delivery.is_acknowledged else 1


def _fate_text(fate: Fate) -> str:
    if fate.latency_s is not None:
        return f"{fate.outcome.value} after {fate.latency_s * 1e3:.1f} ms"
    doubt = ", but it may have arrived" if fate.may_have_arrived else ""
    return f"{fate.outcome.value}: {fate.reason}{doubt}"


def _ask(client: Client, arguments: argparse.Namespace) -> int:
    client.wait_for_peer(arguments.to, 0.0)
    answer = client.request(arguments.topic, arguments.payload.encode(), to=arguments.to, timeout_s=arguments.timeout)
    sys.stdout.buffer.write(answer)
    sys.stdout.flush()
    return 0


def _metrics(client: Client, arguments: argparse.Namespace) -> int:
    from udp_mesh.metrics import render

    if arguments.listen is None:
        print(render(client.stats()), end="")
        return 0
    from udp_mesh.metrics_server import MetricsServer

    host, _, port = arguments.listen.rpartition(":")
    try:
        with MetricsServer((host, int(port)), client) as server:
            print(f"metrics at http://{host}:{server.server_port}/metrics", flush=True)
            server.serve_forever()
    except (OSError, ValueError, OverflowError) as error:
        print(f"udp-mesh: cannot listen at {arguments.listen}: {error}", file=sys.stderr)
        return 2
    return 0


def _subscribe(client: Client, arguments: argparse.Namespace) -> int:
    client.subscribe(arguments.topic)
    for number, message in enumerate(client, start=1):
        if arguments.raw:
            sys.stdout.buffer.write(message.payload)
        else:
            text = message.payload.decode("utf-8", "replace")
            print(f"{message.received_ns / 1e9:.6f} {message.source} {message.topic} {message.priority} {text}")
        sys.stdout.flush()
        if number == arguments.count:
            break
    return 0


def _peers(client: Client, arguments: argparse.Namespace) -> int:
    if arguments.json:
        stats = client.stats()
        print(json.dumps(stats["peers"]))
    else:
        print(_table(client))
    return 0


def _table(client: Client) -> str:
    lines = [f"{'PEER':<20} {'STATE':<8} {'ADDRESS':<16} {'RTT':>9} {'RATE':>12} {'QUEUE':>12} {'QUEUED':>8}"]
    for peer in sorted(client.peers(), key=lambda p: p.name):
        rtt = "-" if peer.srtt_s is None else f"{peer.srtt_s * 1e3:.1f} ms"
        rate = f"{peer.rate_bps / 1e6:.2f} Mbit/s" if peer.rate_bps else "-"
        state = "online" if peer.online else "offline"
        lines.append(
            f"{peer.name:<20} {state:<8} {peer.address:<16} {rtt:>9} {rate:>12}"
            f" {peer.queue_delay_s * 1e3:>9.1f} ms {peer.queued_messages:>8}"
        )
        lines += map(_path, peer.paths if len(peer.paths) > 1 or any(path.via for path in peer.paths) else ())
    return "\n".join(lines)


def _path(path: PathStatus) -> str:
    marks = "in use" if path.in_use else "known"
    way = f"{path.address} (bridge {path.via})" if path.via else path.address
    rate = f", {path.rate_bps / 1e3:g} kbit/s" if path.rate_bps else ""
    return f"  {marks:<18} {way}, heard {path.silent_for_s:.1f} s ago, {path.loss_ratio:.0%} lost{rate}"


def _stats(client: Client, arguments: argparse.Namespace) -> int:
    print(json.dumps(client.stats(), indent=None if arguments.json else 2))
    return 0


def _top(client: Client, arguments: argparse.Namespace) -> int:
    screens = 0
    while True:
        stats = client.stats()
        print(_CLEAR_SCREEN if sys.stdout.isatty() else "", end="")
        print(f"{stats['name']}  {time.strftime('%H:%M:%S')}\n{_table(client)}\n")
        for key, words in (("queues", "waiting or in flight"), ("stored", "in the file, unconfirmed")):
            queues = stats[key]
            if isinstance(queues, dict):
                for topic, depth in sorted(queues.items()):
                    print(f"{topic:<40} {depth:>8} {words}")
        sys.stdout.flush()
        screens += 1
        if screens == arguments.count:
            return 0
        time.sleep(arguments.interval)


def _config(client: Client, arguments: argparse.Namespace) -> int:
    if arguments.action == "set":
        if arguments.key is None or arguments.value is None:
            print("udp-mesh: config set needs a key and a value", file=sys.stderr)
            return 2
        client.config_set(arguments.key, arguments.value)
        return 0
    value: object = client.config_get()
    for part in (arguments.key or "").split(".") if arguments.key else []:
        if not isinstance(value, dict) or part not in value:
            print(f"udp-mesh: there is no setting {arguments.key}", file=sys.stderr)
            return 2
        value = value[part]
    print(json.dumps(value, indent=2))
    return 0


_COMMANDS = {
    "pub": _publish,
    "ask": _ask,
    "metrics": _metrics,
    "sub": _subscribe,
    "peers": _peers,
    "stats": _stats,
    "top": _top,
    "config": _config,
}
