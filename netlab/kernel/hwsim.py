"""mac80211_hwsim's generic netlink interface: make radios, take every frame they send, hand frames to receivers.

Theory (drivers/net/wireless/virtual/mac80211_hwsim.c): a program that registers gets each frame of the radios that were
made in its network namespace, wherever those live now, and is the only way for a frame to reach another radio. Per
frame it sends a copy to each receiver that hears it, with the signal's strength, and one status to the sender: the
attempts made, whether the receiver acknowledged. The status frees the sender's copy, which counts against its socket's
buffer until then.

A radio goes by an address of the kernel's own choice (42:00:00:...), which differs from that of its interfaces.
"""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from netlab.kernel import genl
from netlab.kernel.netlink import HEADER, NLM_F_ACK, NLMSG_ERROR, NetlinkError, NetlinkSocket, attributes

NAME = "MAC80211_HWSIM"

_REGISTER, _FRAME, _TX_INFO_FRAME, _NEW_RADIO = 1, 2, 3, 4
_ADDR_RECEIVER, _ADDR_TRANSMITTER, _ATTR_FRAME, _FLAGS, _RX_RATE, _SIGNAL, _TX_INFO, _COOKIE = 1, 2, 3, 4, 5, 6, 7, 8
_REG_CUSTOM_REG, _DESTROY_RADIO_ON_CLOSE, _RADIO_NAME, _NO_VIF, _FREQ = 12, 16, 17, 18, 19
#: hwsim's own rule set that allows beacons on channels 1-11, 36-48 and 149-165 (hwsim_world_regdom_custom_01).
_REGULATORY_RULES = 0

FLAG_NO_ACK = 1 << 1
FLAG_ACKED = 1 << 2
_MAX_RATES = 4  # IEEE80211_TX_MAX_RATES
_RATES = struct.Struct("=" + "bB" * _MAX_RATES)
_UNUSED_RATE = (-1, 0)
_ERROR = struct.Struct("=i")
_RECEIVE_BYTES = 1 << 16
_SO_RCVBUFFORCE = 33
_BUFFER_BYTES = 8 << 20

#: (index into the band's rates, attempts): what a sender tries, one after the other.
Rate = tuple[int, int]


class SentFrame(NamedTuple):
    """One frame as a radio sent it. ``frame`` is IEEE 802.11 without checksum, ``radio`` the sender's radio address."""

    radio: bytes
    frame: bytes
    flags: int
    rates: tuple[Rate, ...]
    cookie: bytes
    frequency: bytes


@dataclass(frozen=True, slots=True)
class Radio:
    """A radio that was made: its name, and the address that frames give for it."""

    name: str
    address: bytes


def new_radio(family: int, name: str) -> bytes:
    """Make a radio without an interface that goes when the socket closes."""
    flags = genl.attribute(_DESTROY_RADIO_ON_CLOSE) + genl.attribute(_NO_VIF)
    rules = genl.number(_REG_CUSTOM_REG, _REGULATORY_RULES)
    named = genl.attribute(_RADIO_NAME, name.encode())
    # The first radio's number is 0, and so is the answer, which the kernel gives only if asked.
    return genl.message(family, _NEW_RADIO, flags, rules, named, flags=NLM_F_ACK)


def delivery(family: int, receiver: bytes, sent: SentFrame, frame: bytes, *, rate: int, signal_dbm: int) -> bytes:
    """Hand a frame to the radio ``receiver``, heard at ``signal_dbm`` and at the band's rate number ``rate``."""
    return genl.message(
        family,
        _FRAME,
        genl.attribute(_ADDR_RECEIVER, receiver),
        genl.attribute(_ATTR_FRAME, frame),
        genl.number(_RX_RATE, max(rate, 0)),
        genl.number(_SIGNAL, signal_dbm),
        genl.attribute(_FREQ, sent.frequency),
    )


def status(family: int, sent: SentFrame, rates: tuple[Rate, ...], *, acked: bool, signal_dbm: int) -> bytes:
    """Tell a sender what became of its frame: the attempts made at each rate, and whether one was acknowledged."""
    padded = (*rates, *(_UNUSED_RATE,) * (_MAX_RATES - len(rates)))
    return genl.message(
        family,
        _TX_INFO_FRAME,
        genl.attribute(_ADDR_TRANSMITTER, sent.radio),
        genl.number(_FLAGS, sent.flags | (FLAG_ACKED if acked else 0)),
        genl.attribute(_COOKIE, sent.cookie),
        genl.number(_SIGNAL, signal_dbm),
        genl.attribute(_TX_INFO, _RATES.pack(*(value for rate in padded for value in rate))),
    )


def parse_sent(body: bytes) -> SentFrame | None:
    """Read the attributes of a frame message; None where one that every kernel sends is missing."""
    found = attributes(body, 0)
    try:
        (flags,) = struct.unpack("=I", found[_FLAGS])
        values = _RATES.unpack_from(found[_TX_INFO])
        rates = tuple((i, n) for i, n in zip(values[::2], values[1::2], strict=True) if i >= 0 and n)
        return SentFrame(
            found[_ADDR_TRANSMITTER], found[_ATTR_FRAME], flags, rates, found[_COOKIE], found.get(_FREQ, b"")
        )
    except (KeyError, struct.error):
        return None


def split_attempts(rates: tuple[Rate, ...], attempts: int) -> tuple[Rate, ...]:
    """Spread the attempts made over the rates that the sender planned; the last rate takes what is beyond the plan."""
    made: list[Rate] = []
    left = attempts
    for position, (index, planned) in enumerate(rates):
        used = left if position == len(rates) - 1 else min(planned, left)
        if used:
            made.append((index, used))
        left -= used
    return tuple(made)


class HwsimSocket:
    """The one program that carries the frames of this namespace's radios; they and it go when it closes.

    Raises:
        NetlinkError: The kernel has no mac80211_hwsim, another program carries the frames already, or not permitted.
    """

    def __init__(self) -> None:
        control = NetlinkSocket(genl.GENERIC)
        try:
            self.family = genl.family_id(control, NAME)
        finally:
            control.close()
        self._sock = socket.socket(socket.AF_NETLINK, socket.SOCK_RAW | socket.SOCK_CLOEXEC, genl.GENERIC)
        try:
            self._grow()
            self._sock.bind((_own_port(), 0))
            self._ask(genl.message(self.family, _REGISTER, flags=NLM_F_ACK))
        except BaseException:
            self._sock.close()
            raise
        self._sock.setblocking(False)
        self.refused: Counter[str] = Counter()  # the kernel's answers to frames and statuses that it did not take
        self.malformed = 0
        self.overruns = 0  # times that frames were lost because this program was too slow

    def fileno(self) -> int:
        """Readable when frames wait."""
        return self._sock.fileno()

    def make_radio(self, name: str) -> Radio:
        """Make a radio; the name is unique on the machine, also across namespaces.

        Raises:
            NetlinkError: The kernel refuses.
        """
        self._sock.setblocking(True)
        index = self._ask(new_radio(self.family, name))
        self._sock.setblocking(False)
        # mac80211_hwsim_new_radio: 42:00:00, the number in two bytes, 00
        return Radio(name, b"\x42\0\0" + struct.pack("!H", index) + b"\0")

    def send(self, orders: list[bytes]) -> None:
        """Send deliveries and statuses in one system call; what the kernel refuses shows later in ``refused``."""
        try:
            self._sock.sendto(b"".join(order + bytes(-len(order) % 4) for order in orders), (0, 0))
        except OSError as error:
            self._note(error.errno or 0)

    def receive(self) -> list[SentFrame] | None:
        """Return the frames of one datagram, perhaps none; None when nothing waits."""
        try:
            data = self._sock.recv(_RECEIVE_BYTES)
        except BlockingIOError:
            return None
        except OSError as error:
            if error.errno != errno.ENOBUFS:
                raise
            self.overruns += 1
            return []
        return list(self._frames(data))

    def close(self) -> None:
        """Close the socket; its radios go."""
        self._sock.close()

    def _frames(self, data: bytes) -> Iterator[SentFrame]:
        for kind, answer in _split(data):
            if kind == NLMSG_ERROR:
                self._note(-_ERROR.unpack_from(answer, HEADER.size)[0])
            elif kind == self.family and answer[HEADER.size] == _FRAME:
                sent = parse_sent(answer[genl.ATTRIBUTES_AT :])
                if sent is not None:
                    yield sent
                else:
                    self.malformed += 1

    def _note(self, number: int) -> None:
        if number > 0:
            self.refused[errno.errorcode.get(number, str(number))] += 1

    def _ask(self, order: bytes) -> int:
        """Send one order and wait for its answer: 0 or a number of the kernel's."""
        self._sock.sendto(order, (0, 0))
        while True:
            for kind, answer in _split(self._sock.recv(_RECEIVE_BYTES)):
                if kind == NLMSG_ERROR:
                    (number,) = _ERROR.unpack_from(answer, HEADER.size)
                    if number < 0:
                        raise NetlinkError(-number, 0, "")
                    return int(number)

    def _grow(self) -> None:
        """A burst of many radios waits here; an ordinary user gets what net.core.rmem_max allows."""
        try:
            self._sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _BUFFER_BYTES)
        except PermissionError:
            self._sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)


def _own_port() -> int:
    """A netlink port that no other socket of the machine has.

    When any generic netlink socket closes, the kernel removes the radios that were made from its port, whatever its
    namespace (mac80211_hwsim_netlink_notify); the ports that it gives by itself are process ids, and every PID
    namespace has the same ones.
    """
    return 1 << 31 | int.from_bytes(os.urandom(4), "big") >> 2


def missing() -> str | None:
    """Why this kernel cannot make radios, or None."""
    with contextlib.closing(NetlinkSocket(genl.GENERIC)) as sock:
        try:
            genl.family_id(sock, NAME)
        except NetlinkError as error:
            if error.errno == errno.ENOENT:
                return "this kernel has no mac80211_hwsim"
            return f"mac80211_hwsim: {os.strerror(error.errno or 0)}"
    return None


def _split(data: bytes) -> Iterator[tuple[int, bytes]]:
    start = 0
    while start + HEADER.size <= len(data):
        length, kind, _, _, _ = HEADER.unpack_from(data, start)
        if length < HEADER.size:
            return
        yield kind, data[start : start + length]
        start += (length + 3) & ~3
