"""The process of the 802.11 radios: takes each frame that a radio sends, asks the medium, hands it to who hears it.

One thread, one loop, as the air process's. It lives in the lab's root network namespace, where it makes the radios
before they are moved to their nodes; they go with it. A frame counts as sent at the moment it is read: the kernel puts
no time on it. The sender is told of success or failure when its receiver has the frame, so that what its sockets may
have under way stays bounded as with a real radio.

Ends when the lab's channel closes, however the lab ended.
"""

from __future__ import annotations

import argparse
import gc
import select
import sys
import time
from heapq import heappop, heappush

from netlab.engines.air_messages import AskStats, Close, Done, Failed, RecordVerdicts, SetOutage, SetPairs
from netlab.engines.air_verdicts import VerdictStream
from netlab.engines.hwsim_frames import SHORTEST_BYTES, ethernet_of
from netlab.engines.hwsim_messages import HwsimAnswer, HwsimRequest, HwsimStats, MakeRadios, RadiosMade
from netlab.engines.priority import prefer_this_process
from netlab.ipc import Channel
from netlab.kernel import hwsim, syscalls
from netlab.kernel.hwsim import HwsimSocket, SentFrame
from netlab.medium.wifi import Transmission, WifiMedium

_BURST = 16  # datagrams read before departures get their turn


class RadioAir:
    """The data plane of one lab's 802.11 radios."""

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._open = True
        self._sock: HwsimSocket | None = None
        self._medium = WifiMedium((), (), 0)
        self._port_of: dict[bytes, int] = {}  # by the radio's address
        self._radio_of: dict[int, bytes] = {}
        self._departures: list[tuple[float, int, list[bytes]]] = []  # heap of (due_s, order, messages)
        self._order = 0
        self._verdicts: VerdictStream | None = None
        self._frames = 0
        self._unknown_radio = 0
        self._malformed = 0
        self._lost_verdicts = 0  # of earlier streams

    def run(self) -> None:
        """Carry frames until the channel closes."""
        while self._sock is None and self._open:
            self._answer()
        while self._open and self._sock is not None:
            busy = self._receive(self._sock)
            self._depart(self._sock)
            self._wait(self._sock, 0.0 if busy else None)
        if self._verdicts is not None:
            self._verdicts.close()
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

    def _wait(self, sock: HwsimSocket, most_s: float | None) -> None:
        """Sleep until a departure is due, a frame is there or the lab speaks; at most ``most_s``."""
        verdicts = self._verdicts
        writing: list[int] = []
        if verdicts is not None and verdicts.pending:
            verdicts.flush()
            writing = [verdicts.fileno()] if verdicts.pending else []
        if most_s is None and self._departures:
            most_s = max(0.0, self._departures[0][0] - time.monotonic())
        channel = self._channel.fileno()
        readable = select.select([channel, sock.fileno()], writing, [], most_s)[0]
        if channel in readable:
            self._answer()

    # -- the lab's requests ---------------------------------------------------------------------------------------

    def _answer(self) -> None:
        try:
            request, fds = self._channel.recv()
            try:
                answer = self._obey(request, fds)
            except (OSError, ValueError) as error:
                answer = Failed(str(error))
            self._channel.send(answer)
        except (EOFError, BrokenPipeError, ConnectionResetError):
            self._open = False

    def _obey(self, request: HwsimRequest, fds: list[int]) -> HwsimAnswer:
        if isinstance(request, AskStats):
            return self._stats()
        if isinstance(request, MakeRadios):
            self._make(request)
            return RadiosMade()
        if isinstance(request, SetPairs):
            self._medium.set_pairs(request.changes)
        elif isinstance(request, SetOutage):
            self._medium.set_outage(request.pairs, active=request.active)
        elif isinstance(request, RecordVerdicts):
            self._record(fds[0])
        else:
            assert isinstance(request, Close)
            self._open = False
        return Done()

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
        # What lives now lives on, and frames make no cycles: no collection ever needs to stop the loop.
        gc.collect()
        gc.freeze()
        gc.disable()

    def _record(self, fd: int) -> None:
        if self._verdicts is not None:
            self._verdicts.close()
            self._lost_verdicts += self._verdicts.lost
        self._verdicts = VerdictStream(fd)

    def _stats(self) -> HwsimStats:
        sock, verdicts = self._sock, self._verdicts
        return HwsimStats(
            frames=self._frames,
            verdicts=self._medium.counts,
            unaddressed=self._medium.unaddressed,
            unknown_radio=self._unknown_radio,
            malformed=self._malformed + (sock.malformed if sock is not None else 0),
            overruns=sock.overruns if sock is not None else 0,
            refused=dict(sock.refused) if sock is not None else {},
            lost_verdicts=self._lost_verdicts + (verdicts.lost if verdicts is not None else 0),
        )


def main(argv: list[str]) -> int:
    """Carry radio frames for the lab at the other end of ``--channel-fd``."""
    parser = argparse.ArgumentParser(prog="netlab-hwsim")
    parser.add_argument("--channel-fd", type=int, required=True)
    options = parser.parse_args(argv)
    syscalls.set_name("netlab-hwsim")
    prefer_this_process()
    RadioAir(Channel.from_fd(options.channel_fd)).run()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
