"""`netlab run` and `netlab lab` as a user meets them: output, exit codes, mistakes, Ctrl-C."""

from __future__ import annotations

import json
import signal
import time
from pathlib import Path
from typing import Any

import pytest

from netlab.kernel.probe import in_child, tc_features

DATA = Path(__file__).parents[1] / "data" / "cli"
PAIR = DATA / "pair.yaml"

KEYS = {
    *("scenario", "engine", "clock", "seed", "duration_s", "bring_up_s"),
    *("streams", "reconnects", "links", "medium", "processes", "expectations", "capture"),
}
STREAM_KEYS = {
    *("source", "destination", "topic", "priority", "sent", "delivered", "duplicates"),
    *("latency_s", "goodput_bps", "longest_gap_s"),
}


def test_json_is_the_promised_object_and_alone_on_stdout(netlab: Any) -> None:
    # An outage in the middle, so that there is a reconnect to show.
    outage = "events=[{at: 200ms, outage: {between: [a, b], for: 300ms}}]"
    done = netlab("run", PAIR, "--json", "--capture", "kept/run.mcap", "--set", outage, "--set", "expect=[]")
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert set(answer) == KEYS
    assert (answer["scenario"], answer["engine"], answer["clock"], answer["seed"]) == ("mini", "air", "real", 3)
    assert answer["duration_s"] == 1.0
    assert 0 < answer["bring_up_s"] < 5
    (stream,) = answer["streams"]
    assert set(stream) == STREAM_KEYS
    assert set(stream["latency_s"]) == {"p50", "p90", "p99", "max"}
    assert (stream["source"], stream["destination"], stream["sent"]) == ("a", "b", 20)
    assert stream["longest_gap_s"] >= 0.3
    (reconnect,) = answer["reconnects"]
    assert set(reconnect) == {"between", "restored_at_s", "first_delivery_s", "delay_s"}
    assert reconnect["restored_at_s"] == pytest.approx(0.5, abs=0.1)
    assert {(row["from"], row["to"]) for row in answer["links"]} == {("a/eth0", "b/eth0"), ("b/eth0", "a/eth0")}
    costs = {(row["node"], row["process"]): row for row in answer["processes"]}
    assert set(costs) == {*((node, "udp_mesh") for node in "ab"), ("a", "traffic-source"), ("b", "traffic-sink")}
    assert all(0 < row["cpu_s"] < 10 and 5e6 < row["max_rss_bytes"] < 500e6 for row in costs.values())
    assert answer["capture"] == str(netlab.work / "kept" / "run.mcap")
    assert Path(answer["capture"]).stat().st_size > 1000
    assert "2 nodes up" in done.stderr
    assert "pose a>b" in done.stderr


def test_a_report_lies_beside_the_capture_that_it_is_drawn_from(netlab: Any) -> None:
    pytest.importorskip("matplotlib", reason="the extra `report` is not installed")
    done = netlab("run", PAIR, "--report", "told", "--json", "--set", "expect=[]")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["capture"] == str(netlab.work / "told" / "capture.mcap")
    assert "<svg" in (netlab.work / "told" / "index.html").read_text(encoding="utf-8")
    assert done.stderr.splitlines()[-1] == "report: told/index.html"


def test_an_expectation_that_is_not_met_makes_exit_code_1_and_tells_the_story(netlab: Any) -> None:
    settings = ("--seed", 99, "--set", "traffic.0.reliability=best_effort", "--set", "links.0.loss=40%")
    done = netlab("run", PAIR, *settings, "--json")
    assert done.returncode == 1
    assert "NOT MET  delivered of pose" in done.stderr
    assert "the first that is missing is #" in done.stderr
    assert "capture: not kept; name a file for it (--capture FILE)" in done.stderr
    assert "seed 99" in done.stderr
    answer = json.loads(done.stdout)
    assert answer["seed"] == 99
    (expectation,) = answer["expectations"]
    assert set(expectation) == {"name", "passed", "measured", "limit"}
    assert expectation["passed"] is False
    assert expectation["measured"] < 0.95
    assert answer["capture"] is None


def test_a_capture_that_cannot_be_created_is_named(netlab: Any) -> None:
    done = netlab("run", PAIR, "--capture", "/proc/run.mcap")
    assert done.returncode == 2
    assert "/proc/run.mcap: No such file or directory" in done.stderr
    assert "Traceback" not in done.stderr


def test_netem_on_a_kernel_without_it_says_what_to_do(netlab: Any) -> None:
    if in_child(lambda: tc_features().netem_problem) is None:
        pytest.skip("this kernel has sch_netem; the message is for those that lack it")
    done = netlab("run", PAIR, "--engine", "netem")
    assert (done.returncode, done.stdout) == (2, "")
    assert "no sch_netem" in done.stderr
    assert "--engine air" in done.stderr


def _line_with(stream: Any, word: str) -> str:
    for line in stream:
        if word in line:
            return str(line)
    pytest.fail(f"the output ended without {word!r}")


@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_takes_its_lab_down(netlab: Any, signum: int) -> None:
    run = netlab.start("run", PAIR, "--set", "duration=60s")
    _line_with(run.stderr, "running")
    assert len(netlab.labs()) == 1
    run.send_signal(signum)
    _out, err = run.communicate(timeout=10)
    assert (run.returncode, err) == (130, "interrupted; the lab has been taken down\n")
    deadline = time.monotonic() + 1.0
    while netlab.processes():
        assert time.monotonic() < deadline, netlab.processes()
    assert netlab.labs() == []


def test_lab_without_a_terminal_prints_lines_and_ends_with_the_scenario(netlab: Any) -> None:
    done = netlab("lab", PAIR)
    assert done.returncode == 0, done.stderr
    status = done.stderr.splitlines()
    assert status[0].startswith("mini-")
    assert status[-1].startswith("t=  1.0s finished")
    assert "\x1b" not in done.stderr
    assert "met      delivered of pose" in done.stdout
    assert "20 (100 %)" in done.stdout
    assert "traffic-source ended" not in done.stdout
    assert "2 nodes up" not in done.stdout  # progress is on the other stream
    assert "netlab inspect captures/pair.mcap" in done.stdout
    assert (netlab.work / "captures" / "pair.mcap").exists()
    summary = netlab("inspect", "captures/pair.mcap")
    assert summary.returncode == 0
    assert "/a/traffic/published" in summary.stdout
    exported = netlab("export", "captures/pair.mcap", "-o", "pair.pcapng")
    assert exported.returncode == 0
    assert (netlab.work / "pair.pcapng").read_bytes().startswith(b"\x0a\x0d\x0d\x0a")


def test_output_may_be_cut_short_by_its_reader(netlab: Any) -> None:
    process = netlab.start("check", "--schema")
    process.stdout.close()  # as `| head -0` does
    assert "Traceback" not in process.stderr.read()
    process.stdin.close()
    process.stderr.close()
    process.wait(timeout=10)
