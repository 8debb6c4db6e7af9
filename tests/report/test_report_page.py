"""The report of a capture, from the file to the page."""

from __future__ import annotations

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from netlab.capture.scene import Passage, Pose, map_message, poses_message
from netlab.capture.schemas import encode_attempts, encode_verdict, encode_verdict_ends
from netlab.capture.topics import Topics
from netlab.capture.writer import CaptureWriter
from netlab.cli import main
from netlab.errors import CaptureError, MachineError
from netlab.medium.verdicts import Verdict
from netlab.report import build, palette
from netlab.report.build import write_report
from netlab.report.marks import acts_s
from netlab.report.page import Html, Pane, Section, page
from netlab.report.scene import load_scene
from netlab.traces.model import Step, Trace

T0_NS = 1_800_000_000_000_000_000
PLOTS = ("distribution", "latency", "map", "arrivals", "volume", "queues", "signal", "links")


def ns(at_s: float) -> int:
    return T0_NS + round(at_s * 1e9)


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """Robot1 drives 20 m away from base and sends a pulse each second; after 10 s its frames are lost."""
    path = tmp_path / "run.mcap"
    writer = CaptureWriter(path)
    topics = Topics(writer)
    writer.add_metadata("netlab.run", _metadata())
    topics.add_json("/map", map_message([Passage("adit", ((0, 0, 0), (30, 0, 0)), 4.0, 4.0)]), T0_NS)
    for second in range(20):
        poses = [Pose("base", (0, 0, 0), 0.0, True), Pose("robot1", (float(second), 0, 0), 0.0, True)]
        poses.append(Pose("relay", (1.0, 2.0, 0.0), 0.0, second > 5))
        topics.add_json("/poses", poses_message(poses, float(second)), ns(second))
        lost = second >= 14
        ends = encode_verdict_ends(("robot1", "radio0"), ("base", "radio0"))
        verdict = Verdict.OUTAGE if second > 17 else Verdict.LOST if lost else Verdict.DELIVERED
        body = encode_verdict(ends, verdict, 0 if lost else ns(second), 99, 7)
        body += encode_attempts(1, -50 - second)
        topics.writer.add_message(topics.verdicts(), ns(second), ns(second), body)
        message = {"event": "published", "stream": 0, "publication": 0, "seq": second, "size_bytes": 1000}
        topics.add_json("/robot1/traffic/published", {**message, "t_ns": ns(second)}, ns(second))
        if not lost:
            receipt = {**message, "event": "received", "published_ns": ns(second), "t_ns": ns(second + 0.1)}
            topics.add_json("/base/traffic/received", receipt, ns(second + 0.1))
    writer.close()
    return path


def _metadata() -> dict[str, str]:
    stream = {"stream": 0, "source": "robot1", "destination": "base", "topic": "pulse", "priority": 1}
    told = {"name": "corner <1>", "seed": "3", "engine": "air", "duration_s": "20.0", "t0_ns": str(T0_NS)}
    return {**told, "streams": json.dumps([stream]), "ports": "[]"}


def test_the_scene_is_read_with_places_and_decisions(capture: Path) -> None:
    scene = load_scene(capture)
    assert scene.tunnels == {"adit": [(0.0, 0.0), (30.0, 0.0)]}
    assert scene.paths["robot1"][3] == (3.0, 3.0, 0.0)
    assert [at_s for at_s, _, _ in scene.paths["relay"]] == [float(second) for second in range(6, 20)], (
        "not while carried"
    )
    assert scene.success["robot1 > base"][13:15] == [(13.5, 1.0), (14.5, 0.0)]
    assert scene.rssi_dbm["robot1 > base"][0] == (0.5, -50.0)
    assert len(scene.rssi_dbm["robot1 > base"]) == 18, "in an outage nothing is heard"


def test_every_plot_is_there_and_the_page_needs_nothing_else(capture: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="the extra `report` is not installed")
    page = write_report(capture, tmp_path / "new" / "folder")
    text = page.read_text(encoding="utf-8")
    assert page.name == "index.html"
    assert "corner &lt;1&gt;" in text
    assert "corner <1>" not in text
    sections = re.findall(r'<section id="(\w+)".*?</section>', text, flags=re.DOTALL)
    drawn = [name for name in sections if "<svg" in section(text, name)]
    assert tuple(drawn) == PLOTS
    assert "N(1.000 s, 0.000 s)" in text
    assert not re.search(r"<script|src=|@import|#01f0|https?://(?!www.w3.org)", text), "no script, nothing to fetch"
    for picture in re.findall(r"<svg.*?</svg>", text, flags=re.DOTALL):
        ElementTree.fromstring(picture)
    assert palette.style() in text


def section(text: str, name: str) -> str:
    start = text.index(f'<section id="{name}"')
    return text[start : text.index("</section>", start)]


def test_acts_on_the_lab_are_marked_unless_they_are_too_many() -> None:
    steps = [
        Step(ns(at_s), at_s, "", kind)
        for at_s, kind in ((0.0, "start"), (5.0, "outage"), (5.0, "outage"), (9.0, "end"))
    ]
    assert acts_s(Trace(timeline=steps)) == (5.0,)
    assert acts_s(Trace(timeline=[Step(ns(n), float(n), "", "flap_down") for n in range(41)])) == ()


def test_the_same_capture_gives_the_same_page(capture: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="the extra `report` is not installed")
    pages = [write_report(capture, tmp_path / name).read_text(encoding="utf-8") for name in ("one", "two")]
    assert pages[0] == pages[1]


def test_sections_without_data_say_so(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="the extra `report` is not installed")
    empty = tmp_path / "empty.mcap"
    CaptureWriter(empty).close()
    text = write_report(empty, tmp_path / "report").read_text(encoding="utf-8")
    assert "<svg" not in text
    missing = text[text.index('class="missing"') :]
    assert missing.count("<li") == 11
    assert "<b>Map</b>: The capture holds no poses." in missing


def test_no_line_of_a_caption_ends_inside_an_option() -> None:
    section = Section("a", "A", [Pane("<table></table>", "Another: --message <TOPIC>.")], "Or --base.")
    text = page("t", Html(""), [], [section], is_pair=False)
    assert 'Another: <span class="option">--message</span> &lt;TOPIC&gt;.' in text
    assert 'Or <span class="option">--base</span>.' in text
    assert ".option{white-space:nowrap}" in text


def test_an_unknown_topic_or_node_is_named_with_those_that_are_known(capture: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="the extra `report` is not installed")
    with pytest.raises(CaptureError, match=r"run\.mcap: no stream has the topic 'puls'; known are pulse"):
        write_report(capture, tmp_path, topic="puls")
    with pytest.raises(CaptureError, match=r"no stream has the node 'bose'; known are base, robot1"):
        write_report(capture, tmp_path, base="bose")


def test_without_matplotlib_it_says_what_to_install(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(build.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MachineError, match=r"pip install 'udp-mesh-lab\[report\]'"):
        write_report(capture, tmp_path)


def test_the_command_writes_beside_the_capture(capture: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib", reason="the extra `report` is not installed")
    with pytest.raises(SystemExit) as ended:
        main(["report", str(capture)])
    assert not ended.value.code
    assert (capture.with_suffix(".report") / "index.html").exists()
    assert "index.html: " in capsys.readouterr().err


@pytest.mark.parametrize("colours", [palette.LIGHT, palette.DARK])
def test_text_and_series_stand_out_from_the_page(colours: dict[str, str]) -> None:
    """Contrast as WCAG 2.1 defines it: 4.5 for text, 3 for graphics."""
    for text in ("ink", "soft", "link"):
        assert min(contrast(colours[text], colours[ground]) for ground in ("page", "ground")) >= 4.5, text
    for name, colour in colours.items():
        if name not in ("page", "ground", "faint"):
            assert contrast(colour, colours["page"]) >= 3, name


def contrast(a: str, b: str) -> float:
    lighter, darker = sorted((luminance(a), luminance(b)), reverse=True)
    return (lighter + 0.05) / (darker + 0.05)


def luminance(colour: str) -> float:
    parts = [int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
