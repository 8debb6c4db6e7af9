"""A serial line, or a radio modem that behaves like one: datagrams as frames in a stream of bytes (docs/wire.md)."""

from __future__ import annotations

import os
import secrets
import termios
import time
import tty
from collections import Counter
from collections.abc import Iterator

from udp_mesh.core import cobs
from udp_mesh.core.mesh import Datagram, Path
from udp_mesh.io.carrier import CarrierFacts

_EVERYBODY = bytes(2)
_ADDRESS_BYTES = len(_EVERYBODY)
HEADER_BYTES = 2 * _ADDRESS_BYTES
_READ_BYTES = 4096
_MAX_WAITING_BYTES = 16 * 1024
_SPEEDS = {int(name[1:]): getattr(termios, name) for name in dir(termios) if name[0] == "B" and name[1:].isdigit()}
SPEEDS = tuple(sorted(_SPEEDS.keys() - {0}))


def datagram_bytes(frame_bytes: int) -> int:
    """Return the longest datagram whose frame, delimiter included, is no longer than ``frame_bytes``."""
    return frame_bytes - HEADER_BYTES - cobs.overhead_bytes(frame_bytes)


class SerialCarrier:
    """One line. Everybody on it hears everything; two bytes, drawn anew at each opening, tell the nodes apart."""

    is_blocked = False  # what waits here never holds up the other carriers

    def __init__(self, facts: CarrierFacts, counters: Counter[str]) -> None:
        """Open the device and make it raw.

        Raises:
            OSError: It is not there, or is no serial line.
        """
        self.facts = facts
        self.is_broken = False
        self._counters = counters
        self._address = (1 + secrets.randbelow(0xFFFF)).to_bytes(_ADDRESS_BYTES, "big")
        self._deframer = cobs.Deframer(longest_bytes=facts.mtu_bytes + HEADER_BYTES + cobs.overhead_bytes(65_536))
        self._waiting = bytearray(cobs.DELIMITER)  # ends whatever noise the line had before
        self._descriptor = os.open(facts.name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            self._configure()
        except (OSError, termios.error) as error:
            os.close(self._descriptor)
            raise OSError(f"{facts.name} is not a serial line: {error}") from error

    def _configure(self) -> None:
        tty.setraw(self._descriptor, termios.TCSANOW)
        if self.facts.baud:
            attributes = termios.tcgetattr(self._descriptor)
            attributes[4] = attributes[5] = _SPEEDS[self.facts.baud]
            termios.tcsetattr(self._descriptor, termios.TCSANOW, attributes)
        termios.tcflush(self._descriptor, termios.TCIOFLUSH)

    def fileno(self) -> int:
        """The device's descriptor."""
        return self._descriptor

    @property
    def wants_write(self) -> bool:
        """Whether bytes wait for the line."""
        return bool(self._waiting) and not self.is_broken

    def receive(self) -> Iterator[tuple[memoryview, int, Path, float]]:
        """Yield the datagrams that are complete now and are for this node."""
        try:
            data = os.read(self._descriptor, _READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:  # hung up: the next scan of the carriers closes it, and opens it again when it can
            self.is_broken = True
            self._counters["serial_hangups"] += 1
            return
        before = self._deframer.damaged
        now = time.monotonic()
        for frame in self._deframer.feed(data):
            target, source = frame[:_ADDRESS_BYTES], frame[_ADDRESS_BYTES:HEADER_BYTES]
            datagram = frame[HEADER_BYTES:]
            if not datagram or source in (self._address, _EVERYBODY):
                self._counters["serial_bad_frames"] += 1
            elif target in (self._address, _EVERYBODY):
                yield memoryview(datagram), len(datagram), Path(self.facts.index, source.hex()), now
        if self._deframer.damaged > before:
            self._counters["serial_damaged"] += self._deframer.damaged - before

    def send(self, datagrams: list[Datagram], *, window_bytes: int) -> None:
        """Queue datagrams for the line and write what it takes."""
        for burst in datagrams:
            for datagram in burst.segments():
                if len(self._waiting) > _MAX_WAITING_BYTES:
                    self._counters["serial_full"] += 1
                    continue
                target = bytes.fromhex(burst.path.address) or _EVERYBODY
                self._waiting += cobs.encode(target + self._address + datagram)
        self._flush()

    def _flush(self) -> None:
        try:
            while self._waiting and not self.is_broken:
                del self._waiting[: os.write(self._descriptor, self._waiting)]
        except BlockingIOError:
            return
        except OSError:
            self.is_broken = True
            self._counters["serial_hangups"] += 1

    def close(self) -> None:
        """Close the device."""
        os.close(self._descriptor)
