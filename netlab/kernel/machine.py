"""Everything the lab asks of a machine, tried once: the findings behind ``netlab doctor``."""

from __future__ import annotations

import os
import resource
import shutil
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass

from netlab.kernel import hwsim, probe, tun

# Debian keeps these out of an ordinary user's PATH.
_TOOL_PATH = os.pathsep.join((os.environ.get("PATH", os.defpath), "/usr/sbin", "/sbin"))
# A namespace costs the supervisor about ten descriptors: sockets, rings, logs.
_OPEN_FILES_WANTED = 4096

_TOOLS = (
    ("ping", "iputils-ping", "to try a lab by hand"),
    ("tcpdump", "tcpdump", "tests compare captures with it"),
    ("tshark", "tshark", "tests read exported captures with it; for people: Wireshark"),
    ("tc", "iproute2", "to look at qdiscs by hand"),
    ("ip", "iproute2", "`make bench` compares with it"),
)


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing the machine can or cannot do.

    ``needed_for`` says what fails without it, ``essential`` that no lab runs at all, ``detail`` why it is missing,
    ``remedy`` what to do about it (empty if nothing is to be done).
    """

    name: str
    available: bool
    needed_for: str
    essential: bool = False
    detail: str = ""
    remedy: str = ""


def examine() -> list[Finding]:
    """Try everything; takes about a quarter of a second and changes nothing."""
    return [*_isolation(), *_traffic_control(), *_devices(), *_tools(), _open_files()]


def can_run(findings: Iterable[Finding]) -> bool:
    """Whether the lab runs here at all, on the `air` engine."""
    return all(finding.available for finding in findings if finding.essential)


def auto_engine(findings: Iterable[Finding]) -> str:
    """The engine that ``auto`` takes for a scenario that netem can express."""
    available = {finding.name for finding in findings if finding.available}
    return "netem" if {"sch_netem", "frame classifiers"} <= available else "air"


def as_json(findings: list[Finding]) -> dict[str, object]:
    """The findings for programs."""
    runs = can_run(findings)
    return {
        "can_run": runs,
        "auto_engine": auto_engine(findings) if runs else None,
        "findings": [asdict(finding) for finding in findings],
    }


def _isolation() -> list[Finding]:
    namespaces = probe.in_child(probe.try_namespaces)
    remedy = probe.explain_userns_denied() if os.geteuid() else "run it outside the restricted container"
    first = Finding("namespaces", namespaces is None, "every lab", True, namespaces or "", remedy if namespaces else "")
    if namespaces is not None:
        return [first]
    return [
        first,
        _tried("veth", probe.try_veth, "every lab", "load the kernel module veth", essential=True),
        _tried("packet rings", probe.try_packet_ring, "the air engine and captures", "load af_packet", essential=True),
        _tried("mounts", probe.try_mounts, "a private /tmp, /run, /dev/shm and /sys per node", "use an unmasked /proc"),
    ]


def _traffic_control() -> list[Finding]:
    found: list[probe.TcFeatures] = []
    answer = probe.in_child_value(_tc_in_lab, found)
    if answer is not None:
        return [Finding("sch_netem", False, "the netem engine", detail=answer)]
    features = found[0]
    kinds = ", ".join(features.classifiers)
    return [
        Finding(
            "sch_netem",
            features.netem_problem is None,
            "the netem engine",
            detail=features.netem_problem or "",
            remedy="" if features.netem_problem is None else "nothing: the air engine does the same without it",
        ),
        *_netem_details(features),
        Finding("frame classifiers", bool(kinds), "the netem engine", detail=kinds or "neither cls_flower nor cls_u32"),
        Finding("cls_bpf", features.bpf, "nothing yet"),
    ]


def _netem_details(features: probe.TcFeatures) -> list[Finding]:
    if features.netem_problem is not None:
        return []
    without = "random impairments differ from run to run; the air engine's do not"
    return [
        Finding(
            "netem seed",
            features.netem_seed,
            "the same losses in every run",
            detail="" if features.netem_seed else without,
        ),
        Finding("netem duplication", features.netem_duplicates, "`duplicate` on the netem engine"),
    ]


def _tc_in_lab() -> probe.TcFeatures:
    probe.become_lab_root()
    return probe.tc_features()


def _devices() -> list[Finding]:
    mesh_remedy = "sudo modprobe batman-adv, or run such scenarios in a kernel that has it: netlab run FILE --in vm"
    radio_remedy = mesh_remedy.replace("batman-adv", "mac80211_hwsim radios=0", 1)
    return [
        _tried("/dev/net/tun", probe.try_tun, "nodes with mesh: flood, radios of mesh: wnet", tun.REMEDY),
        _tried("batman-adv", probe.try_batman, "nodes with mesh: batman-adv", mesh_remedy),
        _tried("mac80211_hwsim", hwsim.missing, "radios with driver: hwsim", radio_remedy),
    ]


def _tried(
    name: str, trial: Callable[[], str | None], needed_for: str, remedy: str, *, essential: bool = False
) -> Finding:
    problem = probe.in_child(trial)
    return Finding(name, problem is None, needed_for, essential, problem or "", remedy if problem else "")


def _tools() -> list[Finding]:
    found = []
    for tool, package, purpose in _TOOLS:
        path = shutil.which(tool, path=_TOOL_PATH)
        remedy = "" if path else f"sudo apt-get install {package}"
        found.append(Finding(tool, path is not None, purpose, detail=path or "not installed", remedy=remedy))
    return found


def _open_files() -> Finding:
    _soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    enough = hard == resource.RLIM_INFINITY or hard >= _OPEN_FILES_WANTED
    return Finding(
        "open files",
        enough,
        "labs of 100 and more nodes",
        detail=f"hard limit {hard}",
        remedy="" if enough else f"raise `nofile` in /etc/security/limits.conf to {_OPEN_FILES_WANTED}",
    )
