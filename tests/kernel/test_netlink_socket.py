"""The netlink socket: batches, answers that come late, refusals; a fake kernel behind it."""

from __future__ import annotations

import errno
import socket
import struct

import pytest

from netlab.kernel.netlink import HEADER, NLM_F_ACK, NLMSG_DONE, NLMSG_ERROR, NetlinkError, NetlinkSocket

QUESTION = 99
ROOMY, SMALL = 16 * 1024 * 1024, 212_992


class FakeSocket:
    """Answers every message of a batch at once, as the kernel does."""

    def __init__(self, *, forced: bool = True) -> None:
        self.forced = forced
        self.size = SMALL
        self.batches: list[list[tuple[int, int]]] = []  # per send: type and sequence number of each message
        self.refused: dict[int, bytes] = {}  # position in its batch -> the kernel's explanation
        self.answers: list[bytes] = []
        self.closed = False

    def setsockopt(self, level: int, option: int, value: int) -> None:
        if level == socket.SOL_SOCKET:
            if not self.forced:
                raise PermissionError(errno.EPERM, "Operation not permitted")
            self.size = 2 * value

    def getsockopt(self, level: int, option: int) -> int:
        return self.size

    def sendto(self, data: bytes, address: tuple[int, int]) -> None:
        batch, start = [], 0
        while start < len(data):
            length, kind, flags, sequence, _ = HEADER.unpack_from(data, start)
            batch.append((kind, sequence))
            if flags & NLM_F_ACK:
                position = len(batch) - 1
                number = errno.EINVAL if position in self.refused else 0
                self.answers.append(error(sequence, number, self.refused.get(position, b"")))
            start += (length + 3) & ~3
        self.batches.append(batch)

    def recv(self, size: int) -> bytes:
        return self.answers.pop(0)

    def close(self) -> None:
        self.closed = True


def error(sequence: int, number: int, reason: bytes = b"") -> bytes:
    """NLMSG_ERROR (an acknowledgement if ``number`` is 0) with the header of what it answers, capped."""
    text = struct.pack("=HH", 5 + len(reason), 1) + reason + b"\0" if reason else b""
    flags = 0x100 | (0x200 if reason else 0)
    body = struct.pack("=i", -number) + HEADER.pack(HEADER.size, QUESTION, 0, sequence, 0) + text
    return HEADER.pack(HEADER.size + len(body), NLMSG_ERROR, flags, sequence, 0) + body


def message(kind: int, sequence: int = 0, body: bytes = b"") -> bytes:
    return HEADER.pack(HEADER.size + len(body), kind, 0, sequence, 0) + body


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> FakeSocket:
    fake = FakeSocket(forced=getattr(request, "param", True))
    monkeypatch.setattr(socket, "socket", lambda *_: fake)
    return fake


def test_a_whole_lab_is_one_send(kernel: FakeSocket) -> None:
    NetlinkSocket().request([message(QUESTION, body=bytes(200))] * 1000)
    assert [len(batch) for batch in kernel.batches] == [1000]


@pytest.mark.parametrize("kernel", [False], indirect=True)
def test_an_ordinary_user_sends_no_more_than_answers_fit_the_buffer(kernel: FakeSocket) -> None:
    sock = NetlinkSocket()
    sock.request([message(QUESTION)] * 250)
    assert [len(batch) for batch in kernel.batches] == [104, 104, 42]
    kernel.batches.clear()
    sock.request([message(QUESTION, body=bytes(9000))] * 25)
    assert [len(batch) for batch in kernel.batches] == [11, 11, 3]


def test_the_refused_message_is_named_with_the_kernels_own_words(kernel: FakeSocket) -> None:
    kernel.refused = {2: b"netem: no such thing", 3: b"later"}
    with pytest.raises(NetlinkError, match=r"Invalid argument \(netem: no such thing\)") as caught:
        NetlinkSocket().request([message(QUESTION)] * 5)
    assert caught.value.position == 2
    assert caught.value.errno == errno.EINVAL
    assert kernel.answers == []  # all have been read


def test_no_number_is_used_twice_and_late_answers_are_passed_over(kernel: FakeSocket) -> None:
    sock = NetlinkSocket()
    sock.request([message(QUESTION)] * 3)
    kernel.answers.append(error(1, errno.EPERM))  # late, for something before
    sock.request([message(QUESTION)] * 2)
    assert [sequence for batch in kernel.batches for _, sequence in batch] == [0, 1, 2, 3, 4]


def test_numbers_begin_again_where_they_end(kernel: FakeSocket) -> None:
    sock = NetlinkSocket()
    sock._sequence = (1 << 32) - 2
    sock.request([message(QUESTION)] * 3)
    assert [sequence for _, sequence in kernel.batches[0]] == [0, 1, 2]


def test_questions_take_their_own_answers_only(kernel: FakeSocket) -> None:
    sock = NetlinkSocket()
    kernel.answers = [error(7, errno.EPERM), message(QUESTION, 0, b"mine")]
    assert sock.query(message(QUESTION)).endswith(b"mine")
    kernel.answers = [
        message(NLMSG_DONE, 0),
        message(QUESTION, 1, b"one ") + message(QUESTION, 1, b"two "),
        message(NLMSG_DONE, 1),
    ]
    assert [answer[HEADER.size :] for answer in sock.dump(message(QUESTION))] == [b"one ", b"two "]
    kernel.answers = [error(2, errno.ENODEV)]
    with pytest.raises(NetlinkError, match="No such device"):
        sock.query(message(QUESTION))
