"""The host's side of a box, with a kernel made of shell: what it forwards, how it judges, what it leaves behind."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from box_rig import ANSWER, Run, alive, fake_kernel, with_word

from netlab.vm import fitness
from netlab.vm.request import BoxError

pytestmark = pytest.mark.usefixtures("memory")


def within(condition: Callable[[], bool], limit_s: float = 10.0) -> bool:
    end_s = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > end_s:
            return False
        os.sched_yield()
    return True


def test_output_and_exit_code_come_out_apart(tmp_path: Path, memory: Path) -> None:
    run = Run()
    result = run.box("true", kernel=fake_kernel(tmp_path, ANSWER))
    assert (run.out.getvalue(), run.err.getvalue()) == (b"to stdout\n", b"to stderr\n")
    assert (result.exit_code, result.guest_s, result.timed_out) == (7, 1.5, False)
    assert list(memory.iterdir()) == []


def test_the_job_says_all_that_the_guest_needs(tmp_path: Path) -> None:
    kernel = fake_kernel(tmp_path, 'cp "$control/job.json" ' + str(tmp_path) + ANSWER)
    out = tmp_path / "out"
    out.mkdir()
    Run().box("./prog", "a b", kernel=kernel, cwd=tmp_path, output=out)
    job = json.loads((tmp_path / "job.json").read_text())
    assert job["argv"] == ["./prog", "a b"]
    assert (job["cwd"], job["output"], job["shares"]) == (str(tmp_path), str(out), "hostfs")
    assert (job["env"]["NETLAB_VM"], job["env"]["NETLAB_VM_CLOCK"]) == ("1", "virtual")
    assert job["modules"] is None
    assert job["load"] == []


def test_a_kernel_that_ends_at_once_is_told_with_its_console(tmp_path: Path, memory: Path) -> None:
    with pytest.raises(BoxError, match=r"ended at once \(exit code 3\)[^$]*no such luck"):
        Run().box("true", kernel=fake_kernel(tmp_path, "echo no such luck; exit 3"))
    assert list(memory.iterdir()) == []


def test_a_kernel_that_is_no_program_is_told(tmp_path: Path) -> None:
    kernel = fake_kernel(tmp_path, "")
    kernel.path.chmod(0o644)
    with pytest.raises(BoxError, match=r"exit code 126[^$]*Permission denied"):
        Run().box("true", kernel=kernel)


def test_a_guest_that_hangs_in_its_boot_is_ended_by_the_watchdog(tmp_path: Path, memory: Path) -> None:
    kernel = fake_kernel(tmp_path, "echo waiting for nothing; sleep 987651 & sleep 987651")
    with pytest.raises(BoxError, match=r"did not start within 3 s[^$]*waiting for nothing"):
        Run().box("true", kernel=kernel, boot_limit_s=3.0)
    assert not with_word("987651")
    assert list(memory.iterdir()) == []


def test_a_guest_that_breaks_down_is_no_exit_code(tmp_path: Path) -> None:
    run = Run()
    with pytest.raises(BoxError, match=r"broke down .*exit code 137"):
        run.box(
            "true", kernel=fake_kernel(tmp_path, 'echo up >"$control/up"; echo half >"$control/stdout"; kill -9 $$')
        )
    assert run.out.getvalue() == b"half\n"


def test_the_time_limit_is_the_hosts(tmp_path: Path, memory: Path) -> None:
    run = Run()
    script = 'echo up >"$control/up"; echo early >"$control/stdout"; sleep 987652'
    result = run.box("true", kernel=fake_kernel(tmp_path, script), timeout_s=4.0)
    assert (result.exit_code, result.timed_out) == (124, True)
    assert run.out.getvalue() == b"early\n"
    assert not with_word("987652")
    assert list(memory.iterdir()) == []


def test_a_guest_that_cannot_power_off_keeps_its_exit_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("netlab.vm.run.POWER_OFF_LIMIT_S", 0.3)
    result = Run().box("true", kernel=fake_kernel(tmp_path, ANSWER + "sleep 987653"))
    assert result.exit_code == 7
    assert result.wall_s < 15  # far from the time limit of 30 s
    assert not with_word("987653")


def test_output_that_comes_all_at_once_is_forwarded_whole(tmp_path: Path) -> None:
    run, lines = Run(), 300_000
    run.box("true", kernel=fake_kernel(tmp_path, f'seq {lines} >"$control/stdout"{ANSWER}'))
    assert run.out.getvalue().count(b"\n") == lines + 1


CALLER = """
import sys
from pathlib import Path
from netlab.vm.kernels import Emulator, Kernel
from netlab.vm.request import BoxRequest, Clock
from netlab.vm.run import run_in_box
run_in_box(
    BoxRequest(("true",), Path("/"), memory_bytes=128 << 20, clock=Clock.VIRTUAL),
    kernel=Kernel(Emulator.UML, Path(sys.argv[1]), "fake", guests_die=False),
)
"""


@pytest.mark.parametrize("victim", ["caller", "keeper", "nurse", "kernel"])
def test_nothing_is_left_whoever_is_killed(tmp_path: Path, memory: Path, victim: str) -> None:
    word = f"98766{['caller', 'keeper', 'nurse', 'kernel'].index(victim)}{os.getpid()}"
    script = f'setsid sleep {word} & echo up >"$control/up"; echo ready >>"$control/stdout"; sleep {word}'
    kernel = fake_kernel(tmp_path, script)
    caller = subprocess.Popen(
        [sys.executable, "-c", CALLER, str(kernel.path)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    with caller:
        assert caller.stdout is not None
        assert caller.stdout.readline() == b"ready\n"
        chain = {"caller": caller.pid}
        for parent, child in (("caller", "keeper"), ("keeper", "nurse"), ("nurse", "kernel")):
            chain[child] = children(chain[parent])[0]
        assert within(lambda: len(with_word(word)) == 2)
        os.kill(chain[victim], signal.SIGKILL)
        caller.wait(20)
    if victim == "keeper" and os.geteuid() != 0:
        return  # a shell's children die with it only in a PID namespace; the real kernel's always do
    assert within(lambda: not with_word(word))
    assert within(lambda: not any(alive(pid) for pid in chain.values()))
    assert within(lambda: list(memory.iterdir()) == [])


def children(pid: int) -> list[int]:
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def test_no_box_in_a_box(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(fitness.INSIDE, "1")
    with pytest.raises(BoxError, match="inside a box already"):
        Run().box("true", kernel=fake_kernel(tmp_path, ANSWER))


def test_refused_ptrace_is_explained(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fitness, "ptrace_problem", lambda: 1)
    with pytest.raises(BoxError, match="ptrace"):
        Run().box("true", kernel=fake_kernel(tmp_path, ANSWER))
    yama = tmp_path / "ptrace_scope"
    yama.write_text("2\n")
    assert "kernel.yama.ptrace_scope=1" in fitness.explain_no_ptrace(1, yama)
    yama.write_text("1\n")
    assert "--cap-add SYS_PTRACE" in fitness.explain_no_ptrace(1, yama)


def test_ptrace_is_tried_for_real() -> None:
    program = "import ctypes\nfrom netlab.vm import fitness\n" + FORBID_PTRACE + "print(fitness.ptrace_problem())"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "1"


#: seccomp: refuse ptrace (system call 101 on x86-64) with EPERM, allow all else.
FORBID_PTRACE = """
import struct
rules = [(0x20, 0, 0, 0), (0x15, 0, 1, 101), (0x06, 0, 0, 0x00050001), (0x06, 0, 0, 0x7FFF0000)]
code = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *rule) for rule in rules))
filter = struct.pack("HxxxxxxP", len(rules), ctypes.addressof(code))
libc = ctypes.CDLL(None)
assert libc.prctl(38, 1, 0, 0, 0) == 0
assert libc.prctl(22, 2, ctypes.c_char_p(filter), 0, 0) == 0
"""
