"""Services over real sockets, on loopback addresses: what is published, commanded, lost and sealed."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Awaitable, Callable

import pytest

import rose
from rose.core.wire import Fault
from rose.io.udp import UdpTransport
from tests.rose.messages import Note, Pose, Scan

WAIT_S = 10.0
_hosts = itertools.count(1)


def host() -> str:
    """An address that no other test of this process uses."""
    number = next(_hosts)
    return f"127.77.{number // 250}.{number % 250 + 1}"


def run(work: Callable[[], Awaitable[None]]) -> None:
    async def within() -> None:
        async with asyncio.timeout(60):
            await work()

    asyncio.run(within())


class Lossy(UdpTransport):
    """Loses what ``loses`` says, by the count of datagrams that were to leave."""

    def __init__(self, loses: Callable[[int], bool]) -> None:
        super().__init__()
        self._loses, self._count = loses, itertools.count()

    def publish(self, datagrams: list[bytes]) -> None:  # type: ignore[override]
        super().publish([d for d in datagrams if not self._loses(next(self._count))])

    def send(self, to: rose.ServiceId, datagrams: list[bytes], *, local: bool = False) -> None:  # type: ignore[override]
        super().send(to, [d for d in datagrams if not self._loses(next(self._count))], local=local)


def test_one_publication_reaches_all_who_listen() -> None:
    async def work() -> None:
        async with (
            rose.Service(f"{host()}/0.1") as laser,
            rose.Service(f"{host()}/0.1") as a,
            rose.Service(f"{host()}/0.2") as b,
        ):
            listening = [service.subscribe(laser.sid, Scan) for service in (a, b, laser)]
            scan = Scan(1.0, [float(beam) for beam in range(2000)])
            laser.publish(scan)
            for subscription in listening:
                sample = await subscription.receive(WAIT_S)
                assert sample is not None
                assert (sample.message, sample.completeness) == (scan, 1.0)

    run(work)


def test_a_listener_hears_only_whom_it_listens_to() -> None:
    async def work() -> None:
        one, other = host(), host()
        async with rose.Service(f"{one}/0.1") as a, rose.Service(f"{other}/0.1") as b, rose.Service(f"{one}/0.9") as c:
            heard = c.subscribe(a.sid, Note)
            b.publish(Note("not for you"))
            a.publish(Note("for you"))
            sample = await heard.receive(WAIT_S)
            assert sample is not None
            assert sample.message == Note("for you")
            c.unsubscribe(a.sid)
            again = c.subscribe(b.sid, Note)
            a.publish(Note("no longer"))
            b.publish(Note("now you"))
            sample = await again.receive(WAIT_S)
            assert sample is not None
            assert sample.message == Note("now you")

    run(work)


def test_losses_are_seen_where_they_matter() -> None:
    async def work() -> None:
        lossy = Lossy(lambda number: number % 5 == 3)
        async with rose.Service(f"{host()}/0.1", transport=lossy) as laser, rose.Service(f"{host()}/0.1") as reader:
            poses = reader.subscribe(laser.sid, Pose)
            for number in range(10):
                laser.publish(Pose(float(number), 0.0))
            lost = []
            for _ in range(8):
                sample = await poses.receive(WAIT_S)
                assert sample is not None
                lost.append(sample.lost_before)
            assert lost == [0, 0, 0, 1, 0, 0, 0, 1][: len(lost)]
            assert poses.counters.lost == 2

    run(work)


def test_a_scan_with_a_hole_is_given_out_with_the_hole() -> None:
    async def work() -> None:
        lossy = Lossy(lambda number: number == 1)
        async with rose.Service(f"{host()}/0.1", transport=lossy) as laser, rose.Service(f"{host()}/0.1") as reader:
            scans = reader.subscribe(laser.sid, Scan, partial_after_s=0.05)
            laser.publish(Scan(1.0, [float(beam) for beam in range(500)]))
            sample = await scans.receive(WAIT_S)
            assert sample is not None
            assert 0.5 < sample.completeness < 1.0
            assert len(sample.missing) == 1

    run(work)


def test_a_slow_reader_loses_the_oldest_and_knows() -> None:
    async def work() -> None:
        async with rose.Service(f"{host()}/0.1") as a, rose.Service(f"{host()}/0.1") as b:
            notes = b.subscribe(a.sid, Note, samples_max=3)
            for number in range(10):
                a.publish(Note(str(number)))
            while notes.counters.delivered < 10:
                await asyncio.sleep(0)
            newest = notes.take_latest()
            assert newest is not None
            assert newest.message == Note("9")
            assert notes.overflowed == 7
            assert notes.take() is None

    run(work)


def test_commands_are_carried_out_once_though_they_and_their_answers_get_lost() -> None:
    async def work() -> None:
        done: list[str] = []

        async def take(note: Note) -> rose.Message:
            done.append(note.text)
            return Note(f"did {note.text}")

        loses = Lossy(lambda number: number % 3 != 2)
        answers_lost = Lossy(lambda number: number % 2 == 0)
        async with (
            rose.Service(f"{host()}/0.1", transport=loses) as asker,
            rose.Service(f"{host()}/0.1", transport=answers_lost) as robot,
        ):
            robot.on_command(Note, take)
            for text in ("left", "right", "stop"):
                answer = await asker.call(robot.sid, Note(text), Note, timeout_s=WAIT_S)
                assert answer == Note(f"did {text}")
            assert done == ["left", "right", "stop"]

    run(work)


def test_refusals_and_silence_say_why() -> None:
    async def work() -> None:
        async def take(_pose: Pose) -> None:
            raise ValueError("that is a wall")

        async with rose.Service(f"{host()}/0.1") as asker, rose.Service(f"{host()}/0.1") as robot:
            robot.on_command(Pose, take)
            with pytest.raises(rose.CallError, match="refuses: that is a wall"):
                await asker.call(robot.sid, Pose(1.0, 2.0), rose.Done, timeout_s=WAIT_S)
            with pytest.raises(rose.CallError, match="refuses: takes no command of type test/note"):
                await asker.call(robot.sid, Note("x"), rose.Done, timeout_s=WAIT_S)
            with pytest.raises(rose.CallError, match=r"did not answer within 0.2 s; is it running"):
                await asker.call(f"{host()}/0.7", Note("x"), rose.Done, timeout_s=0.2)

    run(work)


def test_with_a_key_everything_is_sealed_both_ways() -> None:
    async def work() -> None:
        ring = rose.KeyRing(team=[bytes(range(32))])
        async with (
            rose.Service(f"{host()}/0.1", keys=ring) as robot,
            rose.Service(f"{host()}/0.1", keys=ring) as friend,
            rose.Service(f"{host()}/0.1") as stranger,
        ):
            robot.on_command(Note, lambda note: _echo(note))
            heard, blind = friend.subscribe(robot.sid, Note), stranger.subscribe(robot.sid, Note)
            robot.publish(Note("secret"))
            sample = await heard.receive(WAIT_S)
            assert sample is not None
            assert sample.message == Note("secret")
            assert await friend.call(robot.sid, Note("hello"), Note, timeout_s=WAIT_S) == Note("hello")
            with pytest.raises(rose.CallError, match="did not answer"):
                await stranger.call(robot.sid, Note("let me in"), Note, timeout_s=0.2)
            assert blind.take() is None
            assert stranger.faults == {Fault.UNKNOWN_KEY: 1}
            assert Fault.UNSEALED in robot.faults

    run(work)


async def _echo(note: Note) -> Note:
    return note


def test_one_service_is_one_process() -> None:
    async def work() -> None:
        sid = f"{host()}/0.1"
        async with rose.Service(sid):
            with pytest.raises(rose.RoseError, match=r"port 4097 is taken; another process is this service already"):
                await rose.Service(sid).start()

    run(work)


def test_foreign_bytes_are_counted() -> None:
    async def work() -> None:
        async with rose.Service(f"{host()}/0.1") as robot, rose.Service(f"{host()}/0.1") as friend:
            robot.on_command(Note, lambda note: _echo(note))
            for junk in (b"", b"hello", b"RS\x01", b"RS\x02" + bytes(80), b"RS\x01\x09" + bytes(80)):
                friend.transport.send(robot.sid, [junk])
            assert await friend.call(robot.sid, Note("still there?"), Note, timeout_s=WAIT_S) == Note("still there?")
            assert robot.faults == {Fault.FOREIGN: 2, Fault.TRUNCATED: 1, Fault.VERSION: 1, Fault.MALFORMED: 1}

    run(work)
