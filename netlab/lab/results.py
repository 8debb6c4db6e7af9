"""The verdict on a finished run: figures and expectations from its capture, as one JSON object and as text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from netlab.clock import clock_here
from netlab.errors import CaptureError
from netlab.lab.stalls import NOTABLE_S
from netlab.scenario.expect import PriorityInversionsExpectation, RetransmissionsExpectation
from netlab.scenario.model import Scenario
from netlab.traces.expectations import ExpectationResult, evaluate
from netlab.traces.explain import milliseconds, rate
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
        problems: Processes that ended by themselves and the like; each with what is known of it.
        failures: What broke of the lab itself (its engine, its recorder, the disk). Figures and expectations then
            cover no more than what was captured, and the run counts as not passed whatever they say.
        worst_stall_s: The longest time for which the machine stood still meanwhile, 0 in virtual time. Latencies and
            rates of such a run are partly the machine's.
    """

    summary: dict[str, Any]
    trace: Trace
    expectations: tuple[ExpectationResult, ...]
    problems: tuple[str, ...]
    failures: tuple[str, ...] = ()
    worst_stall_s: float = 0.0

    @property
    def passed(self) -> bool:
        """Whether the lab held and every expectation was met."""
        return not self.failures and all(result.passed for result in self.expectations)

    @property
    def exit_code(self) -> int:
        """Of ``netlab run``: 0 met, 1 not met, 2 the lab broke."""
        return 2 if self.failures else 0 if self.passed else 1

    def stream(self, topic: str, source: str | None = None, destination: str | None = None) -> dict[str, Any]:
        """Figures of the first stream that fits. Raises LookupError when none does."""
        for row in self.summary["streams"]:
            if row["topic"] == topic and source in (None, row["source"]) and destination in (None, row["destination"]):
                return dict(row)
        raise LookupError(f"no stream of {topic} from {source or 'anywhere'} to {destination or 'anywhere'}")

    def report(self) -> str:
        """Figures, expectations and, for those that failed, what happened around the failure; for a person."""
        parts = [summary_text(self.trace), _section("problems", self.problems)]
        parts.append(_section("expectations", [_line(result) for result in self.expectations]))
        parts.append(_section("machine", self._stalls()))
        parts.append(_section(_BROKEN, self.failures))
        return "\n\n".join(part for part in parts if part)

    def brief(self) -> str:
        """Expectations, each in a line, and what went wrong; for where there is no room for the report."""
        parts = [_section("expectations", [_line(result, explained=False) for result in self.expectations])]
        parts += [_section("problems", self.problems), _section(_BROKEN, self.failures)]
        return "\n\n".join(part for part in parts if part)

    def complaints(self) -> str:
        """The part of the report that is not good news; empty if there is none."""
        unmet = [_line(result) for result in self.expectations if not result.passed]
        stalls = self._stalls() if unmet else []
        sections = (_section("problems", self.problems), _section("expectations", unmet), _section("machine", stalls))
        return "\n\n".join(part for part in (*sections, _section(_BROKEN, self.failures)) if part)

    def _stalls(self) -> list[str]:
        if self.worst_stall_s < NOTABLE_S:
            return []
        text = f"it stood still for up to {milliseconds(self.worst_stall_s)}: latencies and rates are partly its own"
        return [f"{text}; a busy machine changes nothing in virtual time (--in vm --clock virtual)"]


_BROKEN = "THE LAB BROKE: figures and expectations cover only what was captured"


def _section(title: str, lines: Sequence[str]) -> str:
    return "\n".join([title, *(f"  {line}" for line in lines)]) if lines else ""


def _measured(result: ExpectationResult) -> str:
    """In the unit of the limit, which stands at the end of the name."""
    if result.measured is None:
        return "nothing to measure"
    if result.name.endswith((" ms", " s")):
        return f"measured {milliseconds(result.measured)}"
    if result.name.endswith("bit/s"):
        return f"measured {rate(result.measured)}"
    return f"measured {result.measured:.4g}"


def _line(result: ExpectationResult, *, explained: bool = True) -> str:
    line = f"{'met    ' if result.passed else 'NOT MET'}  {result.name}  ({_measured(result)})"
    return f"{line}\n{result.explanation}" if explained and result.explanation else line


def evaluate_run(scenario: Scenario, final: dict[str, Any], capture: Path, *, kept: bool) -> RunResult:
    """Judge a run by its capture.

    Args:
        scenario: What was run.
        final: The lab's last status.
        capture: The finished capture.
        kept: Whether it stays after the run.

    Raises:
        CaptureError: The capture cannot be read; with what broke before.
    """
    recorder = final.get("recorder") or {}
    failures = [*final["failures"], *filter(None, [recorder.get("failure")]), *recorder.get("write_errors", ())]
    try:
        trace = load_trace(capture)
    except CaptureError as error:
        raise CaptureError("\n".join([*failures, str(error)])) from None
    expectations = tuple(evaluate(scenario.expect, trace))
    if not kept:  # do not send anybody to a file that goes with the lab
        gone = (f"capture: {capture}", "capture: not kept; name a file for it (--capture FILE) to look into it")
        expectations = tuple(replace(row, explanation=row.explanation.replace(*gone)) for row in expectations)
    problems = [text for text in (*final["problems"], *final["notices"]) if text not in failures]
    drops = recorder.get("kernel_drops", {})
    problems += [f"{node}: {count} packets are missing from the capture" for node, count in drops.items() if count]
    return RunResult(
        _summary(scenario, final, trace, expectations, str(capture) if kept else None),
        trace,
        expectations,
        tuple(dict.fromkeys(problems)),
        tuple(dict.fromkeys(failures)),
        final["worst_stall_s"],
    )


def _summary(
    scenario: Scenario,
    final: dict[str, Any],
    trace: Trace,
    expectations: Sequence[ExpectationResult],
    capture: str | None,
) -> dict[str, Any]:
    return {
        "scenario": scenario.name,
        "engine": final["engine"],
        "clock": clock_here(),
        "seed": final["seed"],
        "duration_s": trace.duration_s,
        "bring_up_s": final["bring_up_s"],
        **summary(trace),
        "medium": final.get("medium"),
        "processes": [_process(row) for row in final["used"]],
        "expectations": [
            {"name": result.name, "passed": result.passed, "measured": result.measured, "limit": result.limit}
            for result in expectations
        ],
        "capture": capture,
    }


def _process(row: dict[str, Any]) -> dict[str, Any]:
    """What a process has cost. Computing takes no time in virtual time: there its processor time is not known."""
    return row if clock_here() == "real" else {**row, "cpu_s": None}


def needs_packets(scenario: Scenario) -> bool:
    """Whether an expectation asks for more than applications and daemons report."""
    packet_questions = PriorityInversionsExpectation | RetransmissionsExpectation
    return any(isinstance(expectation, packet_questions) for expectation in scenario.expect)
