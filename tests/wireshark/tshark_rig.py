"""Captures made of a few words, and tshark with the dissectors installed as a user installs them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from scapy.layers.inet import IP, UDP
from scapy.layers.l2 import Ether
from scapy.packet import Packet

from netlab.capture.pcapng import PcapngWriter
from netlab.scapy_layers.udp_mesh import UdpMesh

Row = dict[str, list[str]]
T0_NS = 1_700_000_000_000_000_000
EPOCHS = {"base": 0xA1_0000_00BA, "robot": 0xB2_0000_00B0, "uav": 0xC3_0000_00CA}
ADDRESSES = {"base": "10.0.0.1", "robot": "10.0.0.2", "uav": "10.0.0.3"}
MACS = {"base": "02:00:00:00:00:01", "robot": "02:00:00:00:00:02", "uav": "02:00:00:00:00:03"}
_NEXT_VALUE = "\x1f"


class Tshark:
    """tshark of a user who has installed the dissectors, and what it says of captures."""

    def __init__(self, program: str, home: Path) -> None:
        self.program = program
        self.env = {**os.environ, "HOME": str(home), "WIRESHARK_CONFIG_DIR": str(home / "config")}
        self.env.pop("XDG_CONFIG_HOME", None)

    def __call__(self, file: Path, *words: str) -> str:
        """Return what it prints; neither it nor a dissector may complain."""
        argv = [self.program, "-r", str(file), *words]
        done = subprocess.run(argv, capture_output=True, text=True, env=self.env, check=False, timeout=300)
        complaints = [line for line in done.stderr.splitlines() if not line.startswith("Running as user")]
        assert (done.returncode, complaints) == (0, [])
        assert "Lua Error" not in done.stdout
        return done.stdout

    def rows(
        self, file: Path, *fields: str, where: str = "udp_mesh", passes: int = 2, words: tuple[str, ...] = ()
    ) -> list[Row]:
        """Return the values of fields (all occurrences) of the chosen frames; "frame" is always among them."""
        names = ["frame.number", *fields]
        asked = [word for name in names for word in ("-e", name)]
        shape = ["-T", "fields", "-E", "occurrence=a", "-E", f"aggregator={_NEXT_VALUE}", "-E", "separator=/t"]
        passed = ["-2"] if passes == 2 else []
        text = self(file, *passed, *words, "-Y", where, *shape, *asked)
        parts = [line.split("\t") for line in text.splitlines()]
        assert all(len(part) == len(names) for part in parts)
        return [
            {name: value.split(_NEXT_VALUE) if value else [] for name, value in zip(names, part, strict=True)}
            for part in parts
        ]

    def experts(self, file: Path, *words: str) -> dict[str, int]:
        """Return how often each expert info was given."""
        lines = self(file, *words, "-2", "-q", "-Y", "frame", "-z", "expert").splitlines()
        parts = [line.split(None, 3) for line in lines]
        return {part[3]: int(part[0]) for part in parts if len(part) == 4 and part[0].isdigit()}


def installed_tshark(home: Path) -> Tshark:
    """tshark of a user with this home, the dissectors installed; without tshark the test is skipped, loudly."""
    program = shutil.which("tshark")
    if program is None:
        pytest.skip("tshark is not installed; it judges the dissectors. To run this: sudo apt-get install tshark")
    found = Tshark(program, home)
    subprocess.run([sys.executable, "-m", "netlab", "wireshark", "install"], env=found.env, check=True)
    return found


@dataclass(slots=True)
class Tape:
    """A capture in the making; ``add`` puts down frames in the order of time, ``path`` is the file."""

    path: Path
    _writer: PcapngWriter
    _interfaces: dict[str, int]

    def frame(
        self,
        frame: Packet | bytes,
        at_s: float = 0.0,
        *,
        interface: str = "wire",
        direction: int = 0,
        linktype: int = 1,
    ) -> None:
        """Put down a link-layer frame."""
        if interface not in self._interfaces:
            self._interfaces[interface] = self._writer.add_interface(interface, linktype=linktype, snaplen=65535)
        data, number = bytes(frame), self._interfaces[interface]
        t_ns = T0_NS + round(at_s * 1e9)
        self._writer.add_packet(number, t_ns, data, original_length=len(data), direction=direction)

    def add(
        self,
        datagram: Packet | bytes,
        at_s: float = 0.0,
        *,
        source: str = "base",
        to: str = "",
        interface: str = "wire",
        direction: int = 0,
    ) -> None:
        """Put down a datagram over UDP."""
        broadcast = ("ff:ff:ff:ff:ff:ff", "10.0.0.255")
        mac, address = (MACS[to], ADDRESSES[to]) if to else broadcast
        ethernet = Ether(src=MACS[source], dst=mac) / IP(src=ADDRESSES[source], dst=address)
        frame = ethernet / UDP(sport=8700, dport=8700) / bytes(datagram)
        self.frame(frame, at_s, interface=interface, direction=direction)


def datagram(source: str, to: str, number: int, *frames: Packet, **header: object) -> UdpMesh:
    """What a node sends to another one, or with ``to`` empty to all."""
    tag = EPOCHS[to] & 0xFFFFFFFF if to else 0
    flags = header.pop("flags", 0 if to else "unnumbered")
    return UdpMesh(
        epoch=EPOCHS[source], destination_tag=tag, packet_number=number, flags=flags, frames=list(frames), **header
    )
