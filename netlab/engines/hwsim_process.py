"""The process of the 802.11 radios: takes each frame that a radio sends, asks the medium, hands it to who hears it.

One thread, one loop, as the air process's. It lives in the lab's root network namespace, where it makes the radios
before they are moved to their nodes; they go with it. A frame counts as sent at the moment it is read: the kernel puts
no time on it. The sender is told of success or failure when its receiver has the frame, so that what its sockets may
have under way stays bounded as with a real radio.

Ends when the lab's channel closes, however the lab ended.
"""

from __future__ import annotations

import sys
import time
from heapq import heappop, heappush

from netlab.engines.air_messages import AskStats
from netlab.engines.hwsim_frames import SHORTEST_BYTES, ethernet_of
from netlab.engines.hwsim_messages import HwsimAnswer, HwsimRequest, HwsimStats, MakeRadios, RadiosMade
from netlab.engines.medium_loop import MediumLoop, lab_channel
from netlab.ipc import Channel
from netlab.kernel import hwsim
from netlab.kernel.hwsim import HwsimSocket, SentFrame
from netlab.medium.wifi import Transmission, WifiMedium

_BURST = 16  # datagrams read before departures get their turn


class RadioAir(MediumLoop):
    """The data plane of one lab's 802.11 radios."""

    def __init__(self, channel: Channel) -> None:
        self._medium = WifiMedium((), (), 0)
        super().__init__(channel, self._medium)
        self._sock: HwsimSocket | None = None
        self._port_of: dict[bytes, int] = {}  # by the radio's address
        self._radio_of: dict[int, bytes] = {}
        self._departures: list[tuple[float, int, list[bytes]]] = []  # heap of (due_s, order, messages)
        self._order = 0
        self._frames = 0
        self._unknown_radio = 0
        self._malformed = 0

    def run(self) -> None:
        """Carry frames until the channel closes."""
        while self._sock is None and self._open:
            self._answer()
        while self._open and self._sock is not None:
            busy = self._receive(self._sock)
            self._depart(self._sock)
            self._wait(self._departures[0][0] if self._departures else None, busy=busy)
        self._close_verdicts()
        if self._sock is not None:
            self._sock.close()

    # -- frames ---------------------------------------------------------------------------------------------------

    def _receive(self, sock: HwsimSocket) -> bool:
        """Take a burst through the medium; True when more may wait."""
        for _ in range(_BURST):
            sent = sock.receive()
            if sent is None:
                return False
            for frame in sent:
                self._carry(sock, frame)
        return True

    def _carry(self, sock: HwsimSocket, sent: SentFrame) -> None:
        self._frames += 1
        sender = self._port_of.get(sent.radio)
        if sender is None:
            self._unknown_radio += 1
            return
        now = time.monotonic()
        if len(sent.frame) < SHORTEST_BYTES:
            self._malformed += 1
            return
        done = self._medium.transmit(sender, sent.frame, ack=not sent.flags & hwsim.FLAG_NO_ACK, now=now)
        at_once: list[bytes] = []
        for due, receiver, frame, _verdict in (*done.outcomes, *done.overheard):
            if due >= 0:
                self._at(due, now, self._delivery(sock, sent, done, sender, receiver, frame), at_once)
        self._at(done.done_s, now, self._status(sock, sent, done, sender), at_once)
        if at_once:
            sock.send(at_once)
        if self._verdicts is not None:
            shown = ethernet_of(sent.frame) or sent.frame
            strengths = {outcome[1]: round(self._medium.rssi_dbm(sender, outcome[1])) for outcome in done.outcomes}
            stream, attempts = self._verdicts, done.attempts
            stream.add(done.outcomes, shown, sender, now, time.time_ns(), attempts=attempts, rssi_dbm=strengths)

    def _at(self, due: float, now: float, message: bytes, at_once: list[bytes]) -> None:
        if due <= now:
            at_once.append(message)
        else:
            self._order += 1
            heappush(self._departures, (due, self._order, [message]))

    def _delivery(
        self, sock: HwsimSocket, sent: SentFrame, done: Transmission, sender: int, receiver: int, frame: bytes
    ) -> bytes:
        made = hwsim.split_attempts(sent.rates, done.attempts)
        return hwsim.delivery(
            sock.family,
            self._radio_of[receiver],
            sent,
            frame,
            rate=made[-1][0] if made else 0,
            signal_dbm=round(self._medium.rssi_dbm(sender, receiver)),
        )

    def _status(self, sock: HwsimSocket, sent: SentFrame, done: Transmission, sender: int) -> bytes:
        made = hwsim.split_attempts(sent.rates, done.attempts)
        signal_dbm = self._medium.rssi_dbm(done.outcomes[0][1], sender) if done.acked else 0.0
        return hwsim.status(sock.family, sent, made, acked=done.acked, signal_dbm=round(signal_dbm))

    def _depart(self, sock: HwsimSocket) -> None:
        """Hand over what is due; what becomes due meanwhile waits for the next turn."""
        departures = self._departures
        now = time.monotonic()
        while departures and departures[0][0] <= now:
            sock.send(heappop(departures)[2])

    # -- the lab's requests ---------------------------------------------------------------------------------------

    def _obey(self, request: HwsimRequest, fds: list[int]) -> HwsimAnswer:
        if isinstance(request, AskStats):
            return self._stats()
        if isinstance(request, MakeRadios):
            self._make(request)
            return RadiosMade()
        answer: HwsimAnswer = super()._obey(request, fds)
        return answer

    def _make(self, request: MakeRadios) -> None:
        sock = HwsimSocket()
        try:
            radios = {port: sock.make_radio(name) for port, name in request.names.items()}
        except OSError:
            sock.close()
            raise
        self._radio_of = {port: radio.address for port, radio in radios.items()}
        self._port_of = {address: port for port, address in self._radio_of.items()}
        self._medium = WifiMedium(request.ports, request.segments, request.seed)
        self._sock = sock
        self._begin(self._medium, sock.fileno())

    def _stats(self) -> HwsimStats:
        sock = self._sock
        return HwsimStats(
            frames=self._frames,
            verdicts=self._medium.counts,
            unaddressed=self._medium.unaddressed,
            unknown_radio=self._unknown_radio,
            malformed=self._malformed + (sock.malformed if sock is not None else 0),
            overruns=sock.overruns if sock is not None else 0,
            refused=dict(sock.refused) if sock is not None else {},
            lost_verdicts=self._lost_verdicts,
        )


def main(argv: list[str]) -> int:
    """Carry radio frames for the lab at the other end of ``--channel-fd``."""
    RadioAir(lab_channel("netlab-hwsim", argv)).run()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
