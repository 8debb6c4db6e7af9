"""Services of programs without asyncio."""

from __future__ import annotations

import os
import threading

import pytest

import rose
from rose import sync
from tests.rose.messages import Note

WAIT_S = 10.0
HOSTS = [f"127.76.{os.getpid() % 250}.{number}" for number in range(1, 8)]


def test_publish_subscribe_command_and_call_from_ordinary_code() -> None:
    with sync.Service(f"{HOSTS[0]}/0.1") as robot, sync.Service(f"{HOSTS[1]}/0.1") as operator:
        heard = operator.subscribe(robot.sid, Note)
        robot.publish(Note("hello"))
        sample = heard.receive(WAIT_S)
        assert sample is not None
        assert sample.message == Note("hello")
        assert (heard.counters.delivered, heard.take_latest()) == (1, None)
        assert heard.age_s() < WAIT_S

        threads: list[str] = []

        def handle(note: Note) -> Note:
            threads.append(threading.current_thread().name)
            if note.text == "no":
                raise ValueError("never")
            return Note(note.text.upper())

        robot.on_command(Note, handle)
        assert operator.call(robot.sid, Note("go"), Note, timeout_s=WAIT_S) == Note("GO")
        with pytest.raises(rose.CallError, match="refuses: never"):
            operator.call(robot.sid, Note("no"), Note, timeout_s=WAIT_S)
        assert threading.current_thread().name not in threads, "a handler must not hold up the caller's thread"


def test_nothing_comes_and_nobody_waits_for_ever() -> None:
    with sync.Service(f"{HOSTS[2]}/0.1") as service:
        assert service.subscribe(f"{HOSTS[3]}/0.1", Note).receive(0.05) is None


def test_its_threads_end_with_it_also_when_it_cannot_start() -> None:
    before = set(threading.enumerate())
    with sync.Service(f"{HOSTS[4]}/0.1"), pytest.raises(rose.RoseError, match="is taken"):
        sync.Service(f"{HOSTS[4]}/0.1").start()
    assert set(threading.enumerate()) <= before


def test_many_threads_may_publish() -> None:
    with sync.Service(f"{HOSTS[5]}/0.1") as robot, sync.Service(f"{HOSTS[6]}/0.1") as operator:
        heard = operator.subscribe(robot.sid, Note)
        workers = [threading.Thread(target=lambda n=n: robot.publish(Note(str(n)))) for n in range(20)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
        samples = [heard.receive(WAIT_S) for _ in workers]
        texts = {sample.message.text for sample in samples if sample is not None}  # type: ignore[attr-defined]
        assert texts == {str(n) for n in range(20)}
