"""Keys and what they do, on a screen without a terminal and without a lab (Textual's pilot)."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from textual.pilot import Pilot
from textual.widgets import Input, OptionList, Static

from netlab.tui.app import LabApp
from netlab.tui.chooser import Topology, about
from netlab.tui.dialogs import Form
from netlab.tui.screen import MainScreen
from tests.tui.fake_session import FakeSession

Walk = Callable[[Pilot[Any], FakeSession, MainScreen], Awaitable[None]]


def walk(script: Walk, *, size: tuple[int, int] = (120, 38), captures: Path = Path("captures")) -> FakeSession:
    """Open the screen, do what the script says, close it."""

    async def run() -> FakeSession:
        app = LabApp(FakeSession, Path("small.yaml"), captures=captures, rate_hz=20.0)
        async with app.run_test(size=size) as pilot:
            await until(pilot, lambda: isinstance(app.screen, MainScreen) and app.screen.standing.phase == "running")
            screen, session = app.screen, app.session
            assert isinstance(screen, MainScreen)
            assert isinstance(session, FakeSession)
            await until(pilot, lambda: len(screen.model.shown_links()) == 1)
            await script(pilot, session, screen)
        return session

    return asyncio.run(run())


async def until(pilot: Pilot[Any], condition: Callable[[], object]) -> None:
    for _ in range(1000):
        if condition():
            return
        await pilot.pause(0.01)
    raise AssertionError("this never came")


def said(screen: MainScreen) -> str:
    return str(screen.query_one("#said", Static).render())


def test_nodes_and_links_are_picked_in_turn() -> None:
    async def script(pilot: Pilot[Any], _session: FakeSession, screen: MainScreen) -> None:
        await pilot.press("right")
        assert screen.map.chosen == "base"
        await pilot.press("right")
        assert screen.map.chosen == "robot"
        await pilot.press("right")  # nobody picks a relay that is carried
        assert screen.map.chosen == "base"
        await pilot.press("left")
        assert screen.map.chosen == "robot"
        assert "● udp_mesh ready" in str(screen.query_one("#detail", Static).render())
        await pilot.press("down")
        assert screen.map.chosen == frozenset(("base", "robot"))
        assert "base — robot" in str(screen.query_one("#detail", Static).render())
        await pilot.press("escape")
        assert screen.map.chosen is None

    walk(script)


def test_a_click_picks_what_is_there() -> None:
    async def script(pilot: Pilot[Any], _session: FakeSession, screen: MainScreen) -> None:
        column, row = screen.map.projection.cell((60.0, 0.0))
        await pilot.click("#map", offset=(column + 1, row + 1))  # the border is one cell wide
        assert screen.map.chosen == "robot"
        column, row = screen.map.projection.cell((30.0, 0.0))
        await pilot.click("#map", offset=(column + 1, row + 1))
        assert screen.map.chosen == frozenset(("base", "robot"))

    walk(script)


def test_a_link_is_cut_and_restored_by_the_same_key() -> None:
    async def script(pilot: Pilot[Any], session: FakeSession, screen: MainScreen) -> None:
        await pilot.press("c")
        assert "Pick a link first" in said(screen)
        await pilot.press("down", "c")
        await until(pilot, lambda: screen.model.shown_links()[0].is_cut)
        await pilot.press("c")
        await until(pilot, lambda: len(session.acts) == 2)

    session = walk(script)
    cut = {"do": "outage", "between": ["base", "robot"]}
    assert session.acts == [{**cut, "active": True}, {**cut, "active": False}]


def test_dialogs_ask_for_words() -> None:
    async def script(pilot: Pilot[Any], session: FakeSession, screen: MainScreen) -> None:
        await pilot.press("down", "d")
        await until(pilot, lambda: isinstance(pilot.app.screen, Form))
        form = pilot.app.screen
        for entry, text in zip(form.query(Input), ("5%", "", "1mbit"), strict=True):
            entry.value = text
        form.query(Input).last().focus()
        await pilot.press("enter")
        await until(pilot, lambda: session.acts)
        await pilot.press("f")
        await until(pilot, lambda: isinstance(pilot.app.screen, Form))
        await pilot.press("enter", "enter", "enter")
        await until(pilot, lambda: len(session.acts) == 2)
        await pilot.press("f")
        await until(pilot, lambda: isinstance(pilot.app.screen, Form))
        await pilot.press("escape")
        await until(pilot, lambda: pilot.app.screen is screen)

    ends = {"between": ["base", "robot"]}
    assert walk(script).acts == [
        {"do": "link", **ends, "words": {"loss": "5%", "rate": "1mbit"}},
        {"do": "flap", **ends, "down_s": 1.0, "up_s": 2.0, "for_s": 20.0},
    ]


def test_a_robot_goes_where_the_arrows_say() -> None:
    async def script(pilot: Pilot[Any], session: FakeSession, screen: MainScreen) -> None:
        await pilot.press("right", "right", "m", "left", "left", "up")
        across, down = screen.map.cell_m
        assert screen.map.target_m == pytest.approx((60 - 2 * across, down))
        await pilot.press("g")
        await until(pilot, lambda: session.acts)
        assert screen.map.target_m is None

    [act] = walk(script).acts
    assert (act["do"], act["node"], act["speed_mps"]) == ("move", "robot", 1.5)
    assert act["to"][0] < 60 < act["to"][0] + 10


def test_processes_relays_marks_and_the_timeline() -> None:
    async def script(pilot: Pilot[Any], session: FakeSession, screen: MainScreen) -> None:
        await pilot.press("right", "x")
        await until(pilot, lambda: len(session.acts) == 1)
        await pilot.press("r")
        assert "base has no such process: udp_mesh is ready" in said(screen)
        await pilot.press("p")
        await until(pilot, lambda: len(session.acts) == 2)
        await pilot.press("space")
        await until(pilot, lambda: screen.standing.held)
        await pilot.press("full_stop")
        await until(pilot, lambda: "Done now: outage base-robot begins" in said(screen))
        await pilot.press("space")
        await until(pilot, lambda: not screen.standing.held)
        await pilot.press("b")
        await until(pilot, lambda: isinstance(pilot.app.screen, Form))
        await pilot.press("enter")
        await until(pilot, lambda: len(session.acts) == 6)
        await pilot.press("o", "u")
        await until(pilot, lambda: len(session.acts) == 8)

    acts = walk(script).acts
    assert [act["do"] for act in acts] == ["kill", "deploy", "hold", "step", "resume", "mark", "record", "undo"]
    assert acts[0] == {"do": "kill", "node": "base", "process": "udp_mesh"}
    assert acts[1] == {"do": "deploy", "node": "relay"}


def test_what_was_done_is_saved_beside_the_captures(tmp_path: Path) -> None:
    async def script(pilot: Pilot[Any], session: FakeSession, screen: MainScreen) -> None:
        await pilot.press("w")
        await until(pilot, lambda: isinstance(pilot.app.screen, Form))
        await pilot.press("enter")
        await until(pilot, lambda: session.saved)
        await until(pilot, lambda: "Saved: netlab run" in said(screen))

    assert walk(script, captures=tmp_path).saved == [tmp_path / "small-replay.yaml"]


def test_a_refusal_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    async def script(pilot: Pilot[Any], session: FakeSession, screen: MainScreen) -> None:
        session.refuse = "there is nothing to undo"
        await pilot.press("u")
        await until(pilot, lambda: "there is nothing to undo" in said(screen))

    walk(script)


def test_the_verdict_comes_at_the_end() -> None:
    async def script(pilot: Pilot[Any], session: FakeSession, screen: MainScreen) -> None:
        session.phase = "finished"
        await until(pilot, lambda: screen.verdict)
        detail = screen.query_one("#detail", Static)
        await until(pilot, lambda: "everything" in str(detail.render()))
        await pilot.pause(1.1)  # the panels are drawn again every second
        assert detail.border_title == "result"
        told = str(detail.render())
        assert "a bit more" in " ".join(told.split())  # nothing is cut off
        assert max(map(len, told.splitlines())) <= detail.content_size.width
        assert isinstance(pilot.app, LabApp)
        assert pilot.app.farewell() == "the whole report\n\n"

    walk(script)


@pytest.mark.parametrize("size", [(80, 24), (200, 60)])
def test_small_and_large_terminals(size: tuple[int, int]) -> None:
    async def script(pilot: Pilot[Any], _session: FakeSession, screen: MainScreen) -> None:
        await pilot.press("right", "question_mark")
        await pilot.pause()
        assert screen.query_one("#map").size.height >= 4
        assert screen.query_one("#keys").region.bottom == size[1]

    walk(script, size=size)


def test_topologies_are_chosen_from_a_list() -> None:
    found = [Topology(Path(f"{name}.yaml"), f"About {name}: more.") for name in ("one", "two")]

    async def run() -> None:
        app = LabApp(FakeSession, None, choices=found, rate_hz=20.0)
        async with app.run_test(size=(100, 30)) as pilot:
            await until(pilot, lambda: app.screen.query(OptionList))
            await pilot.press("down")
            assert str(app.screen.query_one("#about", Static).render()) == "About two: more."
            await pilot.press("enter")
            await until(pilot, lambda: isinstance(app.screen, MainScreen))
            assert app.session is not None
            assert app.session.title == "two"

    asyncio.run(run())


def test_a_file_says_what_it_is_about() -> None:
    assert about("# One line,\n# and another.\nname: x\n# not this\n") == "One line, and another."
    assert about("name: x") == ""


def test_shell_in_a_browser_names_the_command_for_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LabApp, "is_web", True)

    async def script(pilot: Pilot[Any], _session: FakeSession, screen: MainScreen) -> None:
        await pilot.press("right", "s")
        assert "netlab shell base" in said(screen)

    walk(script)
