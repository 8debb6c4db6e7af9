"""The plugin's `--lab-clock` and its marker, as a project that uses them meets it.

Most tests here have a kernel that runs the box's command on the host itself: all of the plugin, none of the boot.
"""

from __future__ import annotations

import fcntl
import os
import sys
from pathlib import Path

import pytest

from netlab.vm import cache
from netlab.vm.kernels import Kernel

pytest_plugins = ["pytester"]

CACHE = cache.root()  # before a fixture moves it, and the home folder

KERNEL = f"""#!{sys.executable}
import json, pathlib, subprocess, sys
control = pathlib.Path(sys.argv[-1])
job = json.loads((control / "job.json").read_text())
(control / "up").touch()
with (control / "stdout").open("wb") as out, (control / "stderr").open("wb") as err:
    code = subprocess.run(job["argv"], cwd=job["cwd"], env=job["env"], stdout=out, stderr=err).returncode
(control / "status").write_text(json.dumps({{"exit_code": code, "guest_s": 1.0}}) + chr(10))
"""

HEAD = """
import os, time, warnings
import pytest

TWO = {"name": "two", "duration": "1s", "nodes": {"a": {}, "b": {}}, "links": [{"between": ["a", "b"]}]}
IN_BOX = "NETLAB_VM" in os.environ
virtual = pytest.mark.lab_clock("virtual")
"""


@pytest.fixture(autouse=True)
def _own_options(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("PYTEST_ADDOPTS", "CI", "PYTEST_XDIST_WORKER", "NETLAB_VM_CLOCK"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def host_as_kernel(store: Path, tmp_path: Path) -> None:
    kernel, config = tmp_path / "linux", tmp_path / ".config"
    kernel.write_text(KERNEL)
    config.touch()
    cache.install(kernel, config, "6.1-1")


def run(pytester: pytest.Pytester, tests: str, *options: str) -> pytest.RunResult:
    pytester.makepyfile(test_labs=HEAD + tests)
    return pytester.runpytest_subprocess("-p", "no:cacheprovider", "-rA", *options)


@pytest.mark.usefixtures("host_as_kernel")
@pytest.mark.parametrize("workers", [0, 2])
def test_one_session_reports_what_ran_here_and_there(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, workers: int
) -> None:
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setenv("TMPDIR", str(scratch))
    pytester.makeconftest("def pytest_addoption(parser): parser.addoption('--robot')")
    tests = """
def test_here(): assert not IN_BOX

class TestLabs:
    @pytest.mark.parametrize("x", ["one", "an/other one"])
    def test_lab(self, make_lab, x, request):
        assert IN_BOX and request.config.getoption("--robot") == "r2" and os.environ["ROBOTS"] == "3"
        assert make_lab(TWO).status()["engine"] == "air"

    def test_here_too(self): assert not IN_BOX

@pytest.mark.lab_clock("real")
def test_stays_here(make_lab): assert not IN_BOX

@virtual
@pytest.mark.skipif("not IN_BOX")
def test_conditions_are_judged_there(): pass

@virtual
@pytest.mark.xfail(strict=True)
def test_expected(): assert 0

@virtual
def test_skips(): pytest.skip("no such radio")

@virtual
def test_warns(record_property):
    record_property("colour", "red")
    warnings.warn("careful")
    print("some output")
    assert not IN_BOX

@virtual
def test_teardown(request): request.addfinalizer(lambda: 1 / 0)
"""
    options = ["--lab-clock=virtual", "--robot=r2", "--lab-env=ROBOTS=3", "--lab-engine=air", f"-n{workers}"]
    result = run(pytester, tests, *options, "--junitxml=junit.xml", "-o", "junit_family=xunit1")
    result.assert_outcomes(passed=7, failed=1, errors=1, skipped=1, xfailed=1, warnings=1)
    text = result.stdout.str()
    assert "SKIPPED [1] test_labs.py:" in text
    assert "no such radio" in text
    result.stdout.fnmatch_lines(["*assert not IN_BOX*", "*Captured stdout call*", "some output"])
    result.stdout.fnmatch_lines(["*UserWarning: careful*"])
    assert 'name="colour" value="red"' in (pytester.path / "junit.xml").read_text()
    assert list(scratch.iterdir()) == []


@pytest.mark.usefixtures("host_as_kernel")
def test_the_capture_of_a_failed_test_comes_out(pytester: pytest.Pytester) -> None:
    tests = """
@virtual
def test_wrong(make_lab): assert make_lab(TWO).name == 1
@virtual
def test_right(make_lab): make_lab(TWO)
"""
    result = run(pytester, tests, "--lab-captures=kept")
    result.assert_outcomes(passed=1, failed=1)
    (capture,) = pytester.path.rglob("*.mcap")
    assert capture == pytester.path / "kept" / "test_labs.py_test_wrong.mcap"
    assert capture.read_bytes().endswith(b"\x89MCAP0\r\n")
    result.stdout.fnmatch_lines([f"*kept as {capture}; look into it with: netlab inspect {capture}"])


@pytest.mark.usefixtures("host_as_kernel")
def test_a_test_that_breaks_its_box_is_blamed_and_the_others_get_a_new_one(pytester: pytest.Pytester) -> None:
    tests = """
pytestmark = virtual
def test_first(): pass
def test_ends_it(): os._exit(9)
def test_hangs(): time.sleep(1000)
def test_last(): assert IN_BOX
"""
    result = run(pytester, tests, "--lab-patience=8")
    result.assert_outcomes(passed=2, failed=2)
    result.stdout.fnmatch_lines(["*the session in the box ended early (exit code 9)*"])
    result.stdout.fnmatch_lines(["*nothing was heard from the box for * s of the host's clock (--lab-patience)*"])
    assert "boxes.py" not in result.stdout.str()  # none of our insides


@pytest.mark.usefixtures("host_as_kernel")
def test_a_module_that_only_fails_in_the_box_is_told(pytester: pytest.Pytester) -> None:
    result = run(pytester, "if IN_BOX: import no_such_module\n@virtual\ndef test_a(): pass")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines(["*No module named 'no_such_module'*"])


@pytest.mark.usefixtures("store")
def test_without_a_kernel_the_marker_skips_and_the_option_refuses(pytester: pytest.Pytester) -> None:
    tests = "@virtual\ndef test_a(): pass\ndef test_b(): pass"
    marked = run(pytester, tests)
    marked.assert_outcomes(passed=1, skipped=1)
    marked.stdout.fnmatch_lines(["*runs in virtual time only: *netlab vm build*"])
    asked = run(pytester, tests, "--lab-clock=virtual")
    assert asked.ret == pytest.ExitCode.USAGE_ERROR
    asked.stderr.fnmatch_lines(["ERROR: --lab-clock=virtual: *netlab vm build*"])


@pytest.mark.usefixtures("host_as_kernel")
def test_real_time_alone_on_request(pytester: pytest.Pytester) -> None:
    result = run(pytester, "@virtual\ndef test_a(): pass\ndef test_b(): pass", "--lab-clock=real")
    result.assert_outcomes(passed=1, skipped=1)


def test_a_misspelt_clock_is_one_message(pytester: pytest.Pytester) -> None:
    result = run(pytester, "@pytest.mark.lab_clock('virtuel')\ndef test_a(): pass")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(['*write @pytest.mark.lab_clock("virtual"), or "real"'])


def test_in_a_real_box_time_is_virtual(
    built_kernel: Kernel, pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(CACHE.parents[1]))
    tests = """
@virtual
def test_sleeps():
    began_s = time.monotonic()
    time.sleep(1000)
    assert 1000 <= time.monotonic() - began_s < 1000.1

@virtual
def test_lab(make_lab):
    assert make_lab(TWO).run().passed
    raise AssertionError("so that the capture comes out")
"""
    result = run(pytester, tests, "--durations=1")
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(["1000.0*s call*test_sleeps*"])
    assert (pytester.path / "captures" / "test_labs.py_test_lab.mcap").stat().st_size > 1000


INTERRUPTED = """
import os, signal, threading

def interrupt():
    open("begun").read()  # a pipe: until the test in the box has begun
    os.kill(os.getpid(), signal.SIGINT)

def pytest_sessionstart(session):
    if "NETLAB_VM" not in os.environ:
        signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's job in the background ignores it
        threading.Thread(target=interrupt, daemon=True).start()
"""


@pytest.mark.usefixtures("host_as_kernel")
def test_an_interrupt_ends_the_boxes_and_shows_what_was_seen(pytester: pytest.Pytester) -> None:
    os.mkfifo(pytester.path / "begun")
    pytester.makeconftest(INTERRUPTED)
    tests = """
import fcntl
pytestmark = virtual

def test_fails(): assert IN_BOX == "seen before"

def test_is_interrupted():
    lock = open("lock", "w")
    fcntl.flock(lock, fcntl.LOCK_EX)
    open("begun", "w").close()
    time.sleep(1000)
"""
    result = run(pytester, tests)
    assert result.ret == pytest.ExitCode.INTERRUPTED
    result.stdout.fnmatch_lines(["*KeyboardInterrupt*", "*1 failed*"])
    result.stdout.fnmatch_lines(["E *'seen before'*", "FAILED test_labs.py::test_fails*"])
    assert not result.errlines  # no traceback
    with (pytester.path / "lock").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # the box has ended
