"""What a person is told: golden messages with lines, everything at once, nothing invented."""

from pathlib import Path

import pytest

from netlab.errors import ScenarioError
from netlab.scenario import load_scenario, parse_scenario

DATA = Path(__file__).parents[1] / "data" / "scenario"
SOUND = """\
duration: 20s
nodes:
  base: {processes: [udp_mesh]}
  robot1: {processes: [udp_mesh, {argv: [sleep, 100]}]}
  relay:
links:
  - {between: [base, robot1], rate: 10mbit, delay: 20ms}
  - {between: [robot1, relay]}
traffic:
  - {from: robot1, to: base, topic: telemetry, priority: 1, size: 200B, rate: 10Hz}
events:
  - {at: 5s, outage: {between: [base, robot1], for: 3s}}
expect:
  - {latency: {topic: telemetry}, p99: 60ms}
"""


def problems(text: str, **options: object) -> list[str]:
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(text, name="s.yaml", **options)  # type: ignore[arg-type]
    return caught.value.problems


def edited(old: str, new: str) -> str:
    assert SOUND.count(old) == 1, f"{old!r} must be there once"
    return SOUND.replace(old, new)


def test_the_sound_scenario_is_sound() -> None:
    assert parse_scenario(SOUND).duration_s == 20.0


def test_many_mistakes_are_all_reported_at_once_in_the_order_of_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(DATA)
    with pytest.raises(ScenarioError) as caught:
        load_scenario("many_mistakes.yaml")
    assert caught.value.problems == (DATA / "many_mistakes.txt").read_text().splitlines()


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("rate: 10mbit", "rate: 10", "s.yaml:7: links[0].rate: 10 has no unit; write a rate like 10mbit"),
        ("rate: 10mbit", "rte: 10mbit", "s.yaml:7: links[0].rte: unknown key 'rte'; did you mean 'rate'?"),
        ("rate: 10mbit", "zzz: 1", "s.yaml:7: links[0].zzz: unknown key 'zzz'; known keys are delay, jitter"),
        ("delay: 20ms", "delay: ~", "s.yaml:7: links[0].delay: has no value; give one or remove the key"),
        ("delay: 20ms", "delay: -1ms", "s.yaml:7: links[0].delay: '-1ms' is impossible; it must be zero or more"),
        ("delay: 20ms", "loss: 101%", "s.yaml:7: links[0].loss: '101%' is impossible; the most is 100%"),
        ("delay: 20ms", "limit: 0", "s.yaml:7: links[0].limit: 0 is impossible; a queue holds at least 1 packet"),
        (
            "delay: 20ms",
            "distribution: normal",
            "s.yaml:7: links[0]: distribution shapes the jitter, and there is none",
        ),
        ("delay: 20ms", "delay_correlation: 5%", "s.yaml:7: links[0]: delay_correlation shapes the jitter"),
        (
            "delay: 20ms",
            "distribution: gauss",
            "s.yaml:7: links[0].distribution: 'gauss' is not possible here; use unif",
        ),
        ("delay: 20ms", "loss: {ratio: 1%, state: {p13: 1%}}", "s.yaml:7: links[0].loss: give exactly one of ratio"),
        ("delay: 20ms", "loss: {gemodel: {r: 1%}}", "s.yaml:7: links[0].loss.gemodel.p: is missing; add it"),
        ("delay: 20ms", "loss: {periodic: {every: 0}}", "s.yaml:7: links[0].loss.periodic.every: '0' is impossible"),
        ("delay: 20ms", "loss: {trace: [0, 2]}", "s.yaml:7: links[0].loss.trace: a loss trace consists of 0"),
        ("delay: 20ms", "loss: {trace: x.txt}", "s.yaml:7: links[0].loss.trace: file 'x.txt' cannot be read here"),
        (
            "[robot1, relay]",
            "[robot1, uav7]",
            "s.yaml:8: links[1].between[1]: node 'uav7' is not defined; nodes are base",
        ),
        (
            "[robot1, relay]",
            "[robot1, relai]",
            "links[1].between[1]: node 'relai' is not defined; did you mean 'relay'?",
        ),
        (
            "[robot1, relay]",
            "[relay, relay]",
            "s.yaml:8: links[1].between[1]: joins 'relay' with itself; name two nodes",
        ),
        (
            "[robot1, relay]",
            "[robot1, base]",
            "s.yaml:8: links[1]: link robot1 - base is defined twice (first by links[0]",
        ),
        ("[robot1, relay]", "[robot1]", "s.yaml:8: links[1].between"),
        (
            "  relay:",
            "  relay:\n  a_b:",
            "s.yaml:6: nodes.a_b: 'a_b' is not a valid hostname; use letters, digits and inner hyphens",
        ),
        (
            "  relay:",
            "  relay:\n  1:",
            "s.yaml:6: nodes.1: '1' would be read as an IP address; put a letter in front, as in n1",
        ),
        ("  relay:", f"  relay:\n  {'x' * 64}:", "is 64 characters long; a node's name is its hostname, at most 63"),
        ("  relay:", "  relay:\n  Base:", "s.yaml:6: nodes.Base: differs from 'base' only by case"),
        (
            "  relay:",
            "  relay:\n  base-eth0:",
            "s.yaml:6: nodes.base-eth0: 'base-eth0' is also how an interface of 'base' is called",
        ),
        ("  relay:", "  relay:\n  all:", "s.yaml:6: nodes.all: 'all' has a meaning of its own; choose another name"),
        ("  relay:", "  relay: {mesh: olsr}", "s.yaml:5: nodes.relay.mesh: unknown mesh 'olsr'"),
        (
            "  relay:",
            "  relay: {waypoints: [[0, 0], [5, 0]]}",
            "s.yaml:5: nodes.relay: the waypoints have no speed; add",
        ),
        (
            "  relay:",
            "  relay: {speed: 1m/s}",
            "s.yaml:5: nodes.relay: speed is that of a walk; add waypoints or remove",
        ),
        (
            "  relay:",
            "  relay: {follow: robot1}",
            "s.yaml:5: nodes.relay: follow: NODE and distance: 5m belong together",
        ),
        (
            "  relay:",
            "  relay: {follow: base, distance: 5}",
            "s.yaml:5: nodes.relay.distance: 5 has no unit; write a length",
        ),
        (
            "  relay:",
            "  relay: {carried_by: base, heading: 9deg}",
            "s.yaml:5: nodes.relay: heading means nothing beside carr",
        ),
        (
            "  relay:",
            "  relay: {carried_by: base}",
            "s.yaml:8: links[1]: 'relay' is carried until it is dropped, and no",
        ),
        (
            "  relay:",
            "  relay: {follow: x, distance: 1m}",
            "s.yaml:5: nodes.relay.follow: node 'x' is not defined; nodes",
        ),
        (
            "  relay:",
            "  relay: {follow: relay, distance: 1m}",
            "s.yaml:5: nodes.relay.follow: nodes follow or carry one anoth",
        ),
        (
            "  relay:",
            "  relay: {waypoints: [[0]]}",
            "s.yaml:5: nodes.relay.waypoints[0]: expected [x, y] or [x,",
        ),
        (
            "  relay:",
            "  relay: {waypoints: [[0, 0, {puase: 1s}]]}",
            "waypoints[0]: unknown key 'puase'; did you mean",
        ),
        ("  relay:", "  relay: {rose: {}}", "s.yaml:5: nodes.relay.rose: 'relay' does not run it; add"),
        (
            "  relay:",
            "  relay: {position: [1]}",
            "s.yaml:5: nodes.relay.position: expected [x, y] or [x, y, z] in metres",
        ),
        ("  relay:", "  relay: {radio: {}}", "nodes.relay.radio: there is no radio; give radio: a propagation model"),
        ("  relay:", "  relay: {radio: []}", "nodes.relay.radio: a node has 1 to 8 radios; write none"),
        (
            "  relay:",
            "  relay: {processes: [rosie]}",
            "nodes.relay.processes[0]: unknown process 'rosie'; did you mean 'rose'",
        ),
        ("argv: [sleep, 100]", "argv: sleep", "s.yaml:4: nodes.robot1.processes[1]: argv is a list"),
        ("{argv: [sleep, 100]}", "udp_mesh", "s.yaml:4: nodes.robot1: two processes are called 'udp_mesh'"),
        ("to: base", "to: relay", "s.yaml:10: traffic[0].to: node 'relay' runs no udp_mesh to carry traffic; add"),
        ("to: base", "to: robot1", "s.yaml:10: traffic[0].to: 'robot1' sends to itself; name another node"),
        ("to: base", "to: []", "s.yaml:10: traffic[0].to: the list is empty"),
        ("to: base", "to: [base, nobody]", "s.yaml:10: traffic[0].to[1]: node 'nobody' is not defined"),
        ("size: 200B", "size: 2B", "s.yaml:10: traffic[0].size: '2B' is impossible; it must be at least 18B"),
        ("rate: 10Hz", "rate: 10", "s.yaml:10: traffic[0].rate: 10 has no unit; write a frequency like 10Hz"),
        ("priority: 1", "priority: 256", "s.yaml:10: traffic[0].priority: '256' is impossible; it must be at most 255"),
        ("priority: 1", "priority: high", "s.yaml:10: traffic[0].priority: expected a whole number, found 'high'"),
        ("priority: 1", "redundancy: 9", "s.yaml:10: traffic[0].redundancy: '9' is impossible; it must be at most 8"),
        ("at: 5s", "at: 20s", "s.yaml:12: events[0].at: 20s is not before the end; duration is 20s"),
        ("for: 3s", "for: 0s", "s.yaml:12: events[0].outage.for: '0s' is impossible; it must be above zero"),
        (
            "[base, robot1], for: 3s",
            "[base, relay], for: 3s",
            "s.yaml:12: events[0].outage: 'base' and 'relay' share no",
        ),
        (
            "{at: 5s, outage",
            "{at: 5s, deploy: x, outage",
            "s.yaml:12: events[0]: give exactly one of outage, flap, link, kill, deploy, move, mark, hold; "
            "found outage and deploy",
        ),
        ("{at: 5s, outage", "{at: 5s, restart: 1s, outage", "s.yaml:12: events[0]: restart belongs to kill; remove it"),
        ("for: 3s}", "for: 3s, over: radio}", "s.yaml:12: events[0].outage.over: 'base' and 'robot1' share no radio"),
        (
            "topic: telemetry}",
            "topic: bulk}",
            "s.yaml:14: expect[0].latency.topic: no traffic has topic 'bulk'; topics",
        ),
        (
            "telemetry}",
            "telemetry, from: base}",
            "s.yaml:14: expect[0].latency: no stream of 'telemetry' goes that way",
        ),
        (", p99: 60ms", "", "s.yaml:14: expect[0]: there is no bound; add p50: or p90: or p99: or max:"),
        ("{latency: {topic: telemetry}, p99: 60ms}", "{speed: 1}", "s.yaml:14: expect[0]: asks no known question"),
        ("duration: 20s\n", "duration: 20s\nengine: sim\n", "s.yaml:2: engine: engine 'sim' is not available yet"),
        ("duration: 20s\n", "duration: 20s\nterrain: {}\n", "s.yaml:2: terrain.tunnels: is missing; add it"),
        (
            "duration: 20s\n",
            "duration: 20s\nudp_mesh: {key: x}\n",
            "s.yaml:2: udp_mesh.key: expected 64 hexadecimal digits",
        ),
        ("duration: 20s\n", "duration: 20s\nudp_mesh: {probe: maybe}\n", "s.yaml:2: udp_mesh.probe: expected a switch"),
        ("duration: 20s\n", "", "s.yaml:1: duration: is missing; add it"),
        ("duration: 20s\n", "duration: 20s\nseed: -1\n", "s.yaml:2: seed: '-1' is impossible; it must be at least 0"),
        ("duration: 20s\n", "duration: 20s\nname: a/b\n", "s.yaml:2: name: 'a/b' cannot name files"),
    ],
)
def test_one_mistake_gives_one_message_with_its_line(old: str, new: str, expected: str) -> None:
    found = problems(edited(old, new))
    assert len(found) == 1, found
    assert expected in found[0]
    assert found[0].startswith("s.yaml:")


@pytest.mark.parametrize(
    ("event", "expected"),
    [
        ("{at: 1s, kill: {node: robot1, process: udp_mesj}}", "runs no process 'udp_mesj'; did you mean 'udp_mesh'?"),
        ("{at: 1s, kill: {node: relay, process: x}}", "node 'relay' runs no process 'x'; it runs no process"),
        ("{at: 1s, kill: {node: robot9, process: x}}", "node 'robot9' is not defined; did you mean 'robot1'?"),
        ("{at: 5s, flap: {between: [base, robot1], up: 1s, down: 1s, until: 5s}}", "until is not after at"),
        ("{at: 5s, flap: {between: [base, robot1], up: 1us, down: 1us, until: 9s}}", "more than 10,000 times"),
        ("{at: 5s, flap: {from: base, to: robot1, up: 1s, down: 1s, until: 9s, carrier: true}}", "both directions"),
        ("{at: 5s, link: {between: [base, robot1]}}", "nothing changes; add a word such as loss: 20%"),
        ("{at: 5s, link: {between: [base, robot1], from: base, loss: 1%}}", "use the one or the other"),
        ("{at: 5s, link: {loss: 1%}}", "the two ends are missing"),
        (
            "{at: 5s, link: {between: [base, robot1], loss: 1%}, kill: {node: base, process: udp_mesh}}",
            "exactly one of",
        ),
    ],
)
def test_mistakes_in_events(event: str, expected: str) -> None:
    found = problems(edited("expect:\n", f"  - {event}\nexpect:\n"))
    assert len(found) == 1, found
    assert found[0].startswith("s.yaml:13: events[1]")
    assert expected in found[0]


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        ("{reconnect: {between: [robot1, relay]}, max: 1s}", "nothing is ever restored between 'robot1' and 'relay'"),
        ("{priority_inversions: {at: base}, max: 0}", "node 'base' sends no traffic"),
        ("{retransmissions: {at: relay}, max: 0}", "node 'relay' runs no udp_mesh"),
        ("{delivered: {topic: telemetry}, min: 100}", "100 has no unit; write a percentage"),
        ("{goodput: {topic: telemetry}, min: 100%}", "unknown unit '%'"),
        ("{duplicates: {topic: telemetry}, max: -1}", "it must be at least 0"),
        ("{reconnect: {between: [base, robot1]}, min: 1s}", "unknown key 'min'"),
    ],
)
def test_mistakes_in_expectations(entry: str, expected: str) -> None:
    found = problems(SOUND + f"  - {entry}\n")
    assert any(expected in problem and problem.startswith("s.yaml:15: expect[1]") for problem in found), found


def test_a_wrong_value_does_not_hide_a_wrong_name_in_the_same_entry() -> None:
    found = problems(edited("to: base, topic", "to: bass, topic").replace("10Hz", "10"))
    assert [problem.split(": ")[1] for problem in found] == ["traffic[0].rate", "traffic[0].to"]


def test_a_wrong_node_is_not_held_against_those_who_refer_to_it() -> None:
    found = problems(edited("base: {processes", "base: {prozesses"))
    assert found == ["s.yaml:3: nodes.base.prozesses: unknown key 'prozesses'; did you mean 'processes'?"]


def test_a_dict_is_checked_alike_and_not_changed() -> None:
    source = {"duration": "5s", "nodes": {"a": {}}, "links": [{"between": ["a", "b"]}]}
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(source, overrides=["nodes.a.position=[1, 2]"])
    assert caught.value.problems == ["<dict>: links[0].between[1]: node 'b' is not defined; nodes are a"]
    assert source["nodes"] == {"a": {}}


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"gone\.yaml: cannot be read: No such file"):
        load_scenario(tmp_path / "gone.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ScenarioError, match="not a text file"):
        load_scenario(tmp_path / "binary.yaml")


def test_entries_behind_a_hopeless_one_keep_their_numbers_and_lines() -> None:
    found = problems(edited("  - {between: [base, robot1], rate", "  - 5\n  - {between: [base, robot9], rate"))
    assert found == [
        "s.yaml:7: links[0]: expected a block of keys, found '5'",
        "s.yaml:8: links[1].between[1]: node 'robot9' is not defined; did you mean 'robot1'?",
    ]
