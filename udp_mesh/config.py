"""A node's configuration file (TOML): reading, checking, defaults. All mistakes are reported at once.

name = "robot1"
window = 0                    # congestion control
[topics.telemetry]
priority = 1
lifetime_s = 2.0
[topics.fpv]                  # the paper's point-of-view video: one entry, less urgent than all else
priority = 9
reliability = "best_effort"
keep = "latest"
"""

from __future__ import annotations

import os
import socket
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

from udp_mesh import config_carriers, config_checks, config_neighbours
from udp_mesh.config_carriers import CarrierConfig
from udp_mesh.config_neighbours import Neighbour
from udp_mesh.core import wire
from udp_mesh.core.keys import key_id
from udp_mesh.core.settings import MAX_REDUNDANCY, Keep, Offline, Reliability, Settings, TopicPolicy
from udp_mesh.io.local_socket import default_path


class ConfigError(Exception):
    """A configuration is wrong; ``problems`` lists every mistake as ``file: key: what is wrong; what to do``."""

    def __init__(self, problems: list[str]) -> None:
        super().__init__("\n".join(problems))
        self.problems = problems


@dataclass(frozen=True, slots=True)
class Config:
    """One node's configuration. Sizes in bytes, times in seconds."""

    name: str = field(default_factory=socket.gethostname)
    """This node's name, 1..63 bytes of printable UTF-8, unique in the team; the host's name by default."""
    port: int = 8700
    """UDP port, the same on every node."""
    interfaces: tuple[str, ...] = ()
    """Names of the interfaces to use; empty: every one that is up and has IPv4 and broadcast, except loopback."""
    carriers: tuple[CarrierConfig, ...] = config_carriers.DEFAULT
    """What to send and receive by, in a file tables [[carriers]]; see :class:`CarrierConfig`."""
    neighbours: tuple[Neighbour, ...] | None = None
    """Addresses (IPv4, IPv6, MAC) to which everything for all goes one by one. Given, also as an empty list, nothing
    is ever broadcast but on serial lines; who is not listed and sends to this node is answered."""
    bridge: bool = False
    """Whether this node passes on between its carriers what nodes send that cannot hear each other."""
    payload_bytes: int = 1400
    """Largest datagram, without IP and UDP headers, 256..65000; all of the path must carry it."""
    window: int = 0
    """Datagrams in flight to one peer; 0: congestion control decides. 3 is what the udp_mesh paper used."""
    prioritise: bool = True
    """Whether more urgent messages leave first; false: in the order of publication."""
    probe: bool = True
    """Whether an offline peer is searched for every 25 ms; false: it returns with its next beacon."""
    beacon_interval_s: float = 1.0
    """Least time between beacons, 0.05..60; a large team or a slow channel makes it longer."""
    beacon_share: float = 0.01
    """Part of the channel's time that beacons and answers of the whole team may take, 0.0001..1."""
    channel_bps: float = 6e6
    """Rate of broadcasts on the channel that the team shares, 100..1e12; beacons and probes keep to shares of it."""
    shared_bps: float = 0.0
    """Rate of unicasts on a channel that the whole team shares, 100..1e12; with ``coordinate`` equally urgent backlogs
    then divide its time. 0: unknown, or nodes have links of their own."""
    key: tuple[bytes, ...] = field(default=(), repr=False)
    """The team's key, in a file 64 hexadecimal digits; without it datagrams are neither encrypted nor checked. Up to
    four in a list: the first encrypts, all are understood."""
    socket: str = ""
    """Unix socket of the local applications; empty: see :func:`default_socket`."""
    dscp: bool = False
    """Whether IP headers are marked by priority (docs/tuning.md has the table)."""
    floor: float = 0.0
    """Share of what leaves that is kept for less urgent messages while more urgent ones would take all, 0..0.5."""
    coordinate: bool = False
    """Whether nodes tell each other what waits, and send little while something more urgent waits elsewhere."""
    queue_bytes: int = 16 * 1024 * 1024
    """Payload waiting or in flight in this node, 65536..2^30; beyond it the least urgent is dropped first."""
    store: str = ""
    """File of the messages of topics with ``offline = "store"``; empty: see :meth:`store_path`."""
    store_bytes: int = 64 * 1024 * 1024
    """Payload stored for other nodes, and as much again received for this node's applications, 65536..2^40."""
    store_age_s: float = 86_400.0
    """No message is stored for longer, whatever its lifetime, 1..2592000 (30 days)."""
    team: tuple[str, ...] = ()
    """Names of nodes for which messages are stored before they were ever heard. Its own may be among them."""
    topics: Mapping[str, TopicPolicy] = field(default_factory=dict)
    """Settings by topic."""

    def settings(self, *, trace_fragments: bool = False) -> Settings:
        """Return what the core has to know."""
        return Settings(
            name=self.name,
            payload_bytes=self.payload_bytes,
            keys=self.key,
            bridge=self.bridge,
            window=self.window,
            prioritise=self.prioritise,
            probe=self.probe,
            beacon_interval_s=self.beacon_interval_s,
            beacon_share=self.beacon_share,
            channel_bps=self.channel_bps,
            shared_bps=self.shared_bps,
            queue_bytes=self.queue_bytes,
            floor_ratio=self.floor,
            coordinate=self.coordinate,
            trace_fragments=trace_fragments,
            topics=self.topics,
        )

    def store_path(self) -> str:
        """Return the store's file: ``store``, or one named after the node where state belongs that survives a boot."""
        if self.store:
            return self.store
        if os.environ.get("STATE_DIRECTORY"):  # systemd's, a list
            folder = Path(os.environ["STATE_DIRECTORY"].partition(":")[0])
        elif os.access("/var/lib", os.W_OK):
            folder = Path("/var/lib/udp_mesh")
        else:
            folder = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local/state") / "udp_mesh"
        return str(folder / f"{self.name.replace('/', '_')}.db")


RUNTIME_KEYS = (
    *("bridge", "payload_bytes", "key", "window", "prioritise", "probe", "beacon_interval_s", "queue_bytes"),
    *("floor", "coordinate", "beacon_share", "channel_bps", "shared_bps"),
)


def default_socket() -> str:
    """Return $UDP_MESH_SOCKET, or /run/udp_mesh.sock where that can be written, or one in the user's runtime folder."""
    return default_path("udp_mesh")


def load(path: str) -> Config:
    """Read a configuration file.

    Raises:
        ConfigError: It cannot be read, or something in it is wrong.
    """
    try:
        with Path(path).open("rb") as file:
            table = tomllib.load(file)
    except OSError as error:
        raise ConfigError([f"{path}: cannot be read: {error.strerror}"]) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError([f"{path}: is not TOML: {error}"]) from error
    return parse(table, source=path)


def parse(table: Mapping[str, object], *, source: str) -> Config:
    """Check a configuration that was read already; ``source`` names it in messages.

    Raises:
        ConfigError: With every mistake.
    """
    problems: list[str] = []
    values = _values(table, _CHECKS, prefix=f"{source}: ", skip=("topics",), problems=problems)
    topics: dict[str, TopicPolicy] = {}
    tables = table.get("topics", {})
    if isinstance(tables, dict):
        for name, entry in tables.items():
            topics[name] = _topic(name, entry, source, problems)
    else:
        problems.append(f"{source}: topics: has to be tables like [topics.telemetry]")
    if problems:
        raise ConfigError(problems)
    return replace(Config(), topics=topics, **values)  # type: ignore[arg-type]


def change(config: Config, key: str, text: str) -> Config:
    """Return the configuration with one key changed while the daemon runs; ``text`` is TOML, or a bare word.

    ``key`` is one of ``RUNTIME_KEYS`` or ``topics.NAME.SETTING``.

    Raises:
        ConfigError: The key cannot be changed, or the value is wrong.
    """
    try:
        value: object = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text
    problems: list[str] = []
    if key.startswith("topics.") and key.count(".") >= 2:
        name, setting = key[len("topics.") :].rsplit(".", 1)
        policy = _topic(name, {setting: value}, "config set", problems, base=config.topics.get(name, TopicPolicy()))
        changed = replace(config, topics={**config.topics, name: policy})
    elif key in RUNTIME_KEYS:
        values = _values({key: value}, _CHECKS, prefix="config set: ", skip=(), problems=problems)
        changed = replace(config, **values)  # type: ignore[arg-type]
    else:
        known = ", ".join(RUNTIME_KEYS)
        raise ConfigError([f"config set: {key}: cannot change at run time; these can: {known}, topics.NAME.SETTING"])
    if problems:
        raise ConfigError(problems)
    return changed


def _topic(name: str, entry: object, source: str, problems: list[str], base: TopicPolicy | None = None) -> TopicPolicy:
    prefix = f"{source}: topics.{name}."
    base = base or TopicPolicy()
    if not 0 < len(name.encode()) <= wire.MAX_TOPIC_BYTES:
        problems.append(f"{source}: topics.{name}: a topic's name has 1..{wire.MAX_TOPIC_BYTES} bytes")
    if not isinstance(entry, dict):
        problems.append(f"{source}: topics.{name}: has to be a table")
        return base
    values = _values(entry, _TOPIC_CHECKS, prefix=prefix, skip=(), problems=problems)
    return replace(base, **values)  # type: ignore[arg-type]


def _values(
    table: Mapping[str, object],
    checks: Mapping[str, config_checks.Check],
    *,
    prefix: str,
    skip: tuple[str, ...],
    problems: list[str],
) -> dict[str, object]:
    values: dict[str, object] = {}
    for key, value in table.items():
        if key in checks:
            try:
                values[key] = checks[key](value)
            except ValueError as error:
                found = "" if key == "key" else f", not {value!r}"  # a secret does not belong into a log
                problems.append(f"{prefix}{key}: {error}{found}")
        elif key not in skip:
            known = ", ".join([*checks, *skip])
            problems.append(f"{prefix}{key}: unknown key; known are {known}")
    return values


_CHECKS: dict[str, config_checks.Check] = {
    "name": config_checks.name,
    "port": config_checks.number(1, 65535, whole=True),
    "interfaces": config_checks.interfaces,
    "carriers": config_carriers.check,
    "neighbours": config_neighbours.check,
    "bridge": config_checks.boolean,
    "key": config_checks.key,
    "payload_bytes": config_checks.number(256, 65000, whole=True),
    "window": config_checks.number(0, 100_000, whole=True),
    "prioritise": config_checks.boolean,
    "probe": config_checks.boolean,
    "beacon_interval_s": config_checks.number(0.05, 60, whole=False),
    "beacon_share": config_checks.number(0.0001, 1, whole=False),
    "channel_bps": config_checks.number(100, 1e12, whole=False),
    "shared_bps": config_checks.number(0, 1e12, whole=False),
    "socket": config_checks.text,
    "dscp": config_checks.boolean,
    "floor": config_checks.number(0, 0.5, whole=False),
    "coordinate": config_checks.boolean,
    "queue_bytes": config_checks.number(65536, 1 << 30, whole=True),
    "store": config_checks.text,
    "store_bytes": config_checks.number(65536, 1 << 40, whole=True),
    "store_age_s": config_checks.number(1, 2_592_000, whole=False),
    "team": config_checks.names,
}
_TOPIC_CHECKS: dict[str, config_checks.Check] = {
    "priority": config_checks.number(0, 255, whole=True),
    "reliability": config_checks.one_of(Reliability),
    "keep": config_checks.one_of(Keep),
    "lifetime_s": config_checks.number(0.001, 1e9, whole=False),
    "offline": config_checks.one_of(Offline),
    "rate_limit_hz": config_checks.number(0, 1e6, whole=False),
    "rate_limit_bps": config_checks.number(0, 1e12, whole=False),
    "redundancy": config_checks.number(1, MAX_REDUNDANCY, whole=True),
    "compress": config_checks.compress,
}


def describe(config: Config) -> dict[str, object]:
    """Return the configuration as plain values, for people and JSON."""
    values: dict[str, object] = {f.name: getattr(config, f.name) for f in fields(config) if f.name != "topics"}
    values["carriers"] = config_carriers.describe(config.carriers)
    values["neighbours"] = config_neighbours.describe(config.neighbours)
    values["key"] = [f"id {key_id(key):02x}" for key in config.key]  # never the key itself
    values["topics"] = {name: describe_policy(policy) for name, policy in config.topics.items()}
    return values


def describe_policy(policy: TopicPolicy) -> dict[str, object]:
    """Return a topic's settings as plain values."""
    return {f.name: getattr(policy, f.name) for f in fields(policy)}
