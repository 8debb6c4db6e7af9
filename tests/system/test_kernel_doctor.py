"""doctor on the real machine agrees with what the tests themselves can do."""

from __future__ import annotations

import json

from click.testing import CliRunner

from netlab.cli.doctor import doctor
from netlab.kernel import probe


def test_doctor_finds_what_the_lab_needs_and_leaves_the_machine_alone() -> None:
    result = CliRunner().invoke(doctor, ["--json"])
    answer = json.loads(result.output)
    found = {finding["name"]: finding for finding in answer["findings"]}
    assert found["namespaces"]["available"] == (probe.in_child(probe.try_namespaces) is None)
    assert answer["can_run"] == (result.exit_code == 0)
    assert all(finding["remedy"] == "" for finding in answer["findings"] if finding["available"])
    assert all(finding["detail"] for finding in answer["findings"] if not finding["available"])
