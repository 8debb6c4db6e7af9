"""Probes: trials in children, reasons and ways out in words, and what doctor makes of them."""

from __future__ import annotations

import errno
import json
import os
import signal
from pathlib import Path

import pytest
from click.testing import CliRunner

from netlab.cli import doctor as doctor_module
from netlab.cli.doctor import doctor
from netlab.kernel import machine, probe
from netlab.kernel.machine import Finding, as_json, auto_engine, can_run

LAB = [Finding("namespaces", True, "every lab", True), Finding("veth", True, "every lab", True)]
NO_NAMESPACES = [
    Finding("namespaces", False, "every lab", True, "Operation not permitted", "sudo sysctl -w kernel.x=1"),
    Finding("ping", False, "to try a lab by hand", False, "not installed", "sudo apt-get install iputils-ping"),
]


def sysctls(folder: Path, **values: str) -> Path:
    for name, value in values.items():
        path = folder / name.replace("__", "/")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(value + "\n")
    return folder


@pytest.mark.parametrize(
    ("switch", "value", "command"),
    [
        ("kernel__unprivileged_userns_clone", "0", "sysctl -w kernel.unprivileged_userns_clone=1"),
        ("user__max_user_namespaces", "0", "sysctl -w user.max_user_namespaces=15000"),
        (
            "kernel__apparmor_restrict_unprivileged_userns",
            "1",
            "sysctl -w kernel.apparmor_restrict_unprivileged_userns=0",
        ),
    ],
)
def test_the_switch_that_forbids_user_namespaces_is_named(
    tmp_path: Path, switch: str, value: str, command: str
) -> None:
    text = probe.explain_userns_denied(sysctls(tmp_path, **{switch: value}))
    assert command in text
    assert "sudo" in text
    assert text.count("sysctl -w") == 1


def test_without_a_switch_the_container_is_suspected(tmp_path: Path) -> None:
    allowing = sysctls(tmp_path, kernel__unprivileged_userns_clone="1", user__max_user_namespaces="15000")
    text = probe.explain_userns_denied(allowing)
    assert "sysctl -w" not in text
    assert "seccomp" in text
    assert "(sudo)" in text


def test_a_trial_in_a_child_reports_its_answer_its_error_and_its_death() -> None:
    def fails() -> str | None:
        raise OSError(errno.EPERM, os.strerror(errno.EPERM))

    def dies() -> str | None:
        os.kill(os.getpid(), signal.SIGKILL)
        return None

    assert probe.in_child(lambda: None) is None
    assert probe.in_child(lambda: "no luck") == "no luck"
    assert probe.in_child(fails) == "Operation not permitted"
    assert "status -9" in (probe.in_child(dies) or "")


def test_a_value_comes_back_from_the_child_and_the_parent_is_untouched() -> None:
    before = Path("/proc/self/ns/net").readlink()
    found: list[str] = []

    def visit() -> str:
        probe.become_lab_root()
        return str(Path("/proc/self/ns/net").readlink())

    problem = probe.in_child_value(visit, found)
    assert (problem is None) == (len(found) == 1)
    assert Path("/proc/self/ns/net").readlink() == before
    assert str(before) not in found


def test_the_lab_runs_when_all_that_is_essential_is_there() -> None:
    assert can_run(LAB)
    assert can_run([*LAB, Finding("ping", False, "by hand")])
    assert not can_run(NO_NAMESPACES)


def test_auto_takes_netem_only_with_qdisc_and_classifier() -> None:
    netem, filters = Finding("sch_netem", True, "netem"), Finding("frame classifiers", True, "netem")
    assert auto_engine([*LAB, netem, filters]) == "netem"
    assert auto_engine([*LAB, netem, Finding("frame classifiers", False, "netem")]) == "air"
    assert auto_engine(LAB) == "air"


def test_json_has_no_engine_where_no_lab_runs() -> None:
    assert as_json(NO_NAMESPACES)["auto_engine"] is None
    assert as_json(LAB)["auto_engine"] == "air"


@pytest.mark.parametrize(("findings", "code"), [(LAB, 0), (NO_NAMESPACES, 1)])
def test_doctor_prints_what_to_do_and_its_exit_code_tells(
    findings: list[Finding], code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor_module, "examine", lambda: findings)
    result = CliRunner().invoke(doctor, [])
    assert result.exit_code == code
    if code:
        assert "The lab cannot run here" in result.output
        for finding in findings:
            assert finding.remedy in result.output
    else:
        assert "--engine auto` takes air" in result.output


def test_doctor_json_is_one_object(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor_module, "examine", lambda: NO_NAMESPACES)
    result = CliRunner().invoke(doctor, ["--json"])
    assert result.exit_code == 1
    answer = json.loads(result.output)
    assert answer["can_run"] is False
    assert answer["findings"][0]["detail"] == "Operation not permitted"


def test_where_namespaces_are_forbidden_nothing_else_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probe, "in_child", lambda trial: "Operation not permitted")
    monkeypatch.setattr(probe, "in_child_value", lambda trial, found: "Operation not permitted")
    findings = machine.examine()
    assert not can_run(findings)
    assert [f.name for f in findings if f.essential] == ["namespaces"]
    assert not next(f for f in findings if f.name == "sch_netem").available
