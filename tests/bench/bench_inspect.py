"""How long each question of ``netlab inspect`` takes on a large capture, and how much memory.

Run: python tests/bench/bench_inspect.py [MB]. Writes a capture of that many megabytes (default 300): messages of 200 kB
and telemetry at 48 Mbit/s, 1 % of the frames lost, every packet at both ends, verdicts and acknowledgements. Needs no
namespaces.
"""

from __future__ import annotations

import random
import resource
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).parents[2]))
from tests.traces.captures import Play, data
from udp_mesh.core import wire

BULK_BYTES, FRAGMENT_BYTES, FRAGMENT_S = 200_000, 1362, 0.00023
QUESTIONS = (
    ("--why", "slowest"),
    ("--why", "slowest", "--topic", "telemetry"),
    ("--queues-at", "0.3s"),
    ("--drops",),
    ("--conversations",),
    ("--routes",),
    ("--kind", "packets", "--from", "0.3s", "--to", "0.31s"),
    ("--topic", "telemetry"),
    ("--summary",),
)


class Bulk(Play):
    """A play with whole fragments of random bytes, which do not compress."""

    rng = random.Random(1)

    def fragment(self, seq: int, message_id: int, index: int, count: int) -> bytes:
        size = min(FRAGMENT_BYTES, BULK_BYTES - index * FRAGMENT_BYTES)
        prefix = (
            data(1, seq, message_id=message_id)[wire.DATA_BYTES + 5 : wire.DATA_BYTES + 5 + 18] if index == 0 else b""
        )
        head = wire.encode_data_header(
            message_id=message_id, priority=9, index=index, count=count, payload_bytes=size, topic=b"bulk"
        )
        return head + prefix + self.rng.randbytes(size - len(prefix))


def write(path: Path, size_bytes: int) -> None:
    """One message of bulk and a telemetry message by turns, each fragment acknowledged."""
    play = Bulk(path)
    count = -(-BULK_BYTES // FRAGMENT_BYTES)
    number, at_s, seq = 0, 0.0, 0
    while path.stat().st_size < size_bytes:
        for stream, message_id in ((1, 2 * seq), (0, 2 * seq + 1)):
            play.publish(stream, seq, at_s)
            play.queue(stream, message_id, at_s, fragments=count if stream else 1)
        published_s = at_s
        for index in range(count):
            body = play.fragment(seq, 2 * seq, index, count)
            for lost in (True, False) if play.rng.random() < 0.01 else (False,):
                at_s, number = at_s + FRAGMENT_S, number + 1
                play.transmit(body, at_s, number=number, arrives_s=None if lost else at_s + 0.0205)
            play.acknowledge(at_s + 0.041, number)
        at_s, number = at_s + FRAGMENT_S, number + 1
        play.send(0, seq, at_s, message_id=2 * seq + 1, number=number, arrives_s=at_s + 0.0205)
        for stream, message_id in ((1, 2 * seq), (0, 2 * seq + 1)):
            play.receive(
                stream, seq, at_s + 0.021, published_s=published_s, message_id=message_id, daemon_s=at_s + 0.0207
            )
            play.event(at_s + 0.042, "message_acked", message_id=message_id)
        seq += 1
    play.step(at_s, "end", "over")
    play.writer.close()


def ask(path: Path, question: tuple[str, ...]) -> tuple[float, float, int]:
    """Wall time and CPU time in s, and the peak memory in MB, of one command."""
    before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    measured = "import resource,runpy,sys; sys.argv=sys.argv[1:]; import atexit; " + (
        "atexit.register(lambda: print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, file=sys.stderr)); "
        "runpy.run_module('netlab', run_name='__main__')"
    )
    command = [sys.executable, "-c", measured, "netlab", "inspect", str(path), *question]
    done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.perf_counter() - started, cpu_s, int(done.stderr.split()[-1]) // 1024


def main(size_mb: int = 300) -> int:
    """Print one line per question."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "large.mcap"
        write(path, size_mb * 1_000_000)
        print(f"inspect: a capture of {path.stat().st_size / 1e6:.0f} MB")
        for question in QUESTIONS:
            wall_s, cpu_s, peak_mb = ask(path, question)
            print(f"  {' '.join(question):<44} {wall_s:6.1f} s, {cpu_s:6.1f} s of CPU, {peak_mb:5d} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main(*(int(text) for text in sys.argv[1:2])))
