"""The verdict on a finished run: figures and expectations from its capture, as one JSON object and as text."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from netlab.scenario.expect import PriorityInversionsExpectation, RetransmissionsExpectation
from netlab.scenario.model import Scenario
from netlab.traces.expectations import ExpectationResult, evaluate
from netlab.traces.load import load_trace
from netlab.traces.model import Trace
from netlab.traces.summary import summary
from netlab.traces.tables import summary_text


@dataclass(frozen=True, slots=True)
class RunResult:
    """A run that has come to its end.

    Attributes:
        summary: The object that ``netlab run --json`` prints.
        trace: Ask it anything; see ``netlab.traces``.
        expectations: The scenario's expectations, one result per bound.
        problems: Processes that ended by themselves, a recorder that failed; each with what is known of it.
    """

    summary: dict[str, Any]
    trace: Trace
    expectations: tuple[ExpectationResult, ...]
    problems: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether every expectation was met."""
        return all(result.passed for result in self.expectations)

    def stream(self, topic: str, source: str | None = None, destination: str | None = None) -> dict[str, Any]:
        """Figures of the first stream that fits. Raises LookupError when none does."""
        for row in self.summary["streams"]:
            if row["topic"] == topic and source in (None, row["source"]) and destination in (None, row["destination"]):
                return dict(row)
        raise LookupError(f"no stream of {topic} from {source or 'anywhere'} to {destination or 'anywhere'}")

    def report(self) -> str:
        """Figures, expectations and, for those that failed, what happened around the failure; for a person."""
        parts = [summary_text(self.trace)]
        if self.problems:
            parts.append("\n".join(["problems", *(f"  {problem}" for problem in self.problems)]))
        if self.expectations:
            parts.append("\n".join(["expectations", *(_line(result) for result in self.expectations)]))
        return "\n\n".join(part for part in parts if part)


def _line(result: ExpectationResult) -> str:
    measured = "nothing to measure" if result.measured is None else f"measured {result.measured:.6g}"
    line = f"  {'met    ' if result.passed else 'NOT MET'}  {result.name}  ({measured}, limit {result.limit:.6g})"
    return f"{line}\n{result.explanation}" if result.explanation else line


def evaluate_run(scenario: Scenario, final: dict[str, Any], capture: Path, *, kept: bool) -> RunResult:
    """Judge a run by its capture.

    Args:
        scenario: What was run.
        final: The lab's last status.
        capture: The finished capture.
        kept: Whether it stays after the run.

    Raises:
        CaptureError: The capture cannot be read.
    """
    trace = load_trace(capture)
    expectations = tuple(evaluate(scenario.expect, trace))
    recorder = final.get("recorder") or {}
    problems = [*final["problems"], *final["notices"]]
    drops = recorder.get("kernel_drops", {})
    problems += [f"{node}: {count} packets are missing from the capture" for node, count in drops.items() if count]
    shown = {
        "scenario": scenario.name,
        "engine": final["engine"],
        "clock": "real",
        "seed": final["seed"],
        "duration_s": scenario.duration_s,
        "bring_up_s": final["bring_up_s"],
        **summary(trace),
        "expectations": [
            {"name": result.name, "passed": result.passed, "measured": result.measured, "limit": result.limit}
            for result in expectations
        ],
        "capture": str(capture) if kept else None,
    }
    return RunResult(shown, trace, expectations, tuple(dict.fromkeys(problems)))


def needs_packets(scenario: Scenario) -> bool:
    """Whether an expectation asks for more than applications and daemons report."""
    packet_questions = PriorityInversionsExpectation | RetransmissionsExpectation
    return any(isinstance(expectation, packet_questions) for expectation in scenario.expect)
