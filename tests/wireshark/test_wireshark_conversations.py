"""What datagrams have to do with each other, as tshark shows it: stories of a few frames."""

from __future__ import annotations

import struct
from collections.abc import Callable

from netlab.capture.pcapng import INBOUND, OUTBOUND
from netlab.scapy_layers.udp_mesh import Ack, AckRange, Data, Floor, Hello, Ping, Probe, UdpMesh
from tests.wireshark.tshark_rig import EPOCHS, T0_NS, Row, Tape, Tshark, datagram
from udp_mesh.core.envelope import DurableId, Envelope, encode

RETRANSMISSION = ["udp_mesh.retransmission", "udp_mesh.retransmission_of"]
INVERSION = ["inversion", "inversion.message_id", "inversion.priority", "inversion.done_in", "inversion.waited"]
INVERSION = [f"udp_mesh.{name}" for name in INVERSION]


def told(rows: list[Row], name: str) -> dict[int, list[str]]:
    """The values of a field by frame number, where there are any."""
    return {int(row["frame.number"][0]): row[f"udp_mesh.{name}"] for row in rows if row[f"udp_mesh.{name}"]}


def fragment(message_id: int, index: int, count: int, *, priority: int = 5, data: bytes = b"", flags: int = 0) -> Data:
    topic = {"topic": b"map"} if index == 0 else {}
    return Data(message_id=message_id, index=index, count=count, priority=priority, data=data, flags=flags, **topic)


def traffic(published_s: float, size_bytes: int = 30) -> bytes:
    return struct.pack("<4sHIQ", b"NLT1", 1, 9, T0_NS + round(published_s * 1e9)).ljust(size_bytes, b".")


def test_a_fragment_under_another_number_is_a_retransmission(tshark: Tshark, tape: Tape) -> None:
    tape.add(datagram("base", "robot", 0, fragment(1, 0, 2)), 0.0, to="robot")
    tape.add(datagram("base", "robot", 1, fragment(1, 1, 2)), 0.1, to="robot")
    tape.add(datagram("base", "robot", 2, fragment(1, 0, 2)), 0.2, to="robot")
    tape.add(datagram("base", "uav", 0, fragment(1, 0, 2)), 0.3, to="uav")  # to somebody else: not again
    tape.add(datagram("base", "robot", 2, fragment(1, 0, 2)), 0.4, to="robot")  # the same datagram: on the way
    rows = tshark.rows(tape.path, *RETRANSMISSION, "udp_mesh.duplicate_of")
    assert told(rows, "retransmission_of") == {3: ["1"]}
    assert told(rows, "duplicate_of") == {5: ["3"]}
    assert tshark.experts(tape.path) == {"Retransmission": 1, "Duplicated on the way": 1}
    assert tshark.rows(tape.path, where="udp_mesh.retransmission") == [{"frame.number": ["3"]}]


def test_a_broadcast_to_several_addresses_repeats_nothing(tshark: Tshark, tape: Tape) -> None:
    for to in ("robot", "uav"):
        tape.add(datagram("base", "", 4, fragment(1, 0, 1)), to=to)
    rows = tshark.rows(tape.path, *RETRANSMISSION, "udp_mesh.duplicate_of")
    assert [row["udp_mesh.retransmission"] + row["udp_mesh.duplicate_of"] for row in rows] == [[], []]


def test_each_interface_is_a_view_of_its_own(tshark: Tshark, tape: Tape) -> None:
    """The receiver's interface sees what the sender's saw a little later; the lost one it never sees."""
    lost, again = datagram("base", "robot", 0, fragment(1, 0, 1)), datagram("base", "robot", 1, fragment(1, 0, 1))
    tape.add(lost, 0.0, to="robot", interface="base/eth0", direction=OUTBOUND)
    tape.add(again, 0.1, to="robot", interface="base/eth0", direction=OUTBOUND)
    tape.add(again, 0.103, to="robot", interface="robot/eth0", direction=INBOUND)
    rows = tshark.rows(tape.path, *RETRANSMISSION, *[f"udp_mesh.{n}" for n in ("first_seen_in", "transit_time")])
    assert told(rows, "retransmission_of") == {2: ["1"]}
    assert told(rows, "first_seen_in") == {3: ["2"]}
    assert told(rows, "transit_time") == {3: ["0.003000000"]}


def test_acknowledgements_are_told_with_their_times(tshark: Tshark, tape: Tape) -> None:
    for number in range(4):
        tape.add(datagram("base", "robot", number, Ping()), 0.1 * number, to="robot")
    ack = Ack(largest=3, first_range=0, ranges=[AckRange(gap=0, length=1)])  # 3, 0-1
    tape.add(datagram("robot", "base", 0, ack), 0.5, source="robot", to="base")
    tape.add(datagram("robot", "base", 1, ack), 0.6, source="robot", to="base")
    tape.add(datagram("uav", "base", 0, Ack(largest=2)), 0.7, source="uav", to="base")  # not the one it was sent to
    rows = tshark.rows(
        tape.path, *[f"udp_mesh.{n}" for n in ("acked_in", "acked_after", "ack.frame", "ack.response_time")]
    )
    assert told(rows, "acked_in") == {1: ["5"], 2: ["5"], 4: ["5"]}
    assert told(rows, "acked_after") == {1: ["0.500000000"], 2: ["0.400000000"], 4: ["0.200000000"]}
    assert told(rows, "ack.frame") == {5: ["1", "2", "4"]}
    assert told(rows, "ack.response_time") == {5: ["0.200000000"]}


def test_names_are_known_before_they_are_told(tshark: Tshark, tape: Tape) -> None:
    tape.add(datagram("base", "robot", 0, Ping()), to="robot")
    tape.add(datagram("base", "", 0, Hello(node=b"base")), 0.1)
    tape.add(datagram("robot", "", 0, Hello(node=b"robot")), 0.2, source="robot")
    both = ("udp_mesh.sender", "udp_mesh.receiver")
    rows = tshark.rows(tape.path, *both)
    assert [(row[both[0]], row[both[1]]) for row in rows] == [
        (["base"], ["robot"]),
        (["base"], ["all"]),
        (["robot"], ["all"]),
    ]
    assert "base → robot PING" in tshark(tape.path, "-2", "-Y", "udp_mesh")
    first, *_rest = tshark.rows(tape.path, *both, passes=1)
    assert first[both[0]] == [f"{EPOCHS['base'] & 0xFFFFFFFF:08x}"]  # one pass knows what was told before


def test_a_restarted_node_is_noticed(tshark: Tshark, tape: Tape) -> None:
    for at_s, epoch in enumerate([1, 1, 2, 2]):
        tape.add(UdpMesh(epoch=epoch, flags="unnumbered", packet_number=at_s, frames=[Hello(node=b"base")]), at_s)
    assert tshark.experts(tape.path) == {"The node was restarted: its epoch is new": 1}


def test_a_probe_is_tied_to_its_answer(tshark: Tshark, tape: Tape) -> None:
    robot, base = (EPOCHS[name] & 0xFFFFFFFF for name in ("robot", "base"))
    tape.add(datagram("base", "", 0, Probe(wanted=[robot])), 0.0)
    tape.add(datagram("base", "", 1, Probe(wanted=[robot])), 0.025)
    tape.add(datagram("robot", "", 0, Hello(node=b"robot", heard=[base])), 0.03, source="robot")
    rows = tshark.rows(tape.path, *[f"udp_mesh.{n}" for n in ("answered_in", "answer_to", "answer_time")])
    assert told(rows, "answered_in") == {2: ["3"]}
    assert told(rows, "answer_to") == {3: ["2"]}
    assert told(rows, "answer_time") == {3: ["0.005000000"]}


def test_a_question_is_tied_to_its_answer(tshark: Tshark, tape: Tape) -> None:
    ask = encode(Envelope(request=77, stored=DurableId(5, 6), floor=4)) + b"?"
    answer = encode(Envelope(response=77, status=1)) + b"!"
    tape.add(datagram("base", "robot", 0, fragment(1, 0, 1, data=ask, flags=1)), 0.0, to="robot")
    reply = datagram("robot", "base", 0, fragment(1, 0, 1, data=answer, flags=1))
    tape.add(reply, 0.25, source="robot", to="base")
    names = ("request_in", "response_in", "request_time", "envelope.store", "envelope.sequence", "envelope.floor")
    names += ("envelope.request", "envelope.response", "envelope.status", "message")
    rows = tshark.rows(tape.path, *[f"udp_mesh.{name}" for name in names])
    assert told(rows, "response_in") == {1: ["2"]}
    assert (told(rows, "request_in"), told(rows, "request_time")) == ({2: ["1"]}, {2: ["0.250000000"]})
    assert (told(rows, "envelope.store"), told(rows, "envelope.sequence")) == ({1: ["0x0000000000000005"]}, {1: ["6"]})
    assert (told(rows, "envelope.floor"), told(rows, "envelope.status")) == ({1: ["4"]}, {2: ["1"]})
    assert told(rows, "message") == {1: ["3f"], 2: ["21"]}


def test_a_damaged_envelope_is_named(tshark: Tshark, tape: Tape) -> None:
    tape.add(datagram("base", "robot", 0, fragment(1, 0, 1, data=b"\x01", flags=1)), to="robot")
    assert tshark.experts(tape.path) == {"Envelope cannot be read: the message is dropped": 1}


def test_a_message_is_reassembled_whatever_the_order(tshark: Tshark, tape: Tape) -> None:
    whole = traffic(-0.25, 70)
    parts = [whole[:26], whole[26:56], whole[56:]]  # the topic and its length take 4 bytes of the first
    for number, index in enumerate([1, 2, 0, 1]):
        tape.add(datagram("base", "robot", number, fragment(1, index, 3, data=parts[index])), 0.1 * number, to="robot")
    names = ["reassembled_in", "fragment", "message.length", "message.time", "topic"]
    latency = "netlab_traffic.latency"
    rows = tshark.rows(tape.path, *[f"udp_mesh.{name}" for name in names], latency, "netlab_traffic.filling")
    assert told(rows, "reassembled_in") == {1: ["3"], 2: ["3"], 4: ["3"]}
    assert told(rows, "fragment") == {3: ["3", "1", "2"]}
    assert told(rows, "message.length") == {3: [str(len(whole))]}
    assert told(rows, "message.time") == {3: ["0.200000000"]}
    assert told(rows, "topic") == {1: ["map"], 2: ["map"], 3: ["map"], 4: ["map"]}
    assert rows[2][latency] == ["0.450000000"]
    assert rows[2]["netlab_traffic.filling"] == [whole[18:].hex()]
    assert "Reassembled message (70 bytes)" in tshark(tape.path, "-2", "-x", "-Y", "frame.number == 3")


def test_one_pass_tells_what_came_before(tshark: Tshark, tape: Tape) -> None:
    for index in range(2):
        tape.add(datagram("base", "robot", index, fragment(1, index, 2, data=b"x")), 0.1 * index, to="robot")
    names = ["udp_mesh.topic", "udp_mesh.reassembled_in", "udp_mesh.message.length"]
    rows = tshark.rows(tape.path, *names, passes=1)
    assert told(rows, "topic") == {1: ["map"], 2: ["map"]}
    assert (told(rows, "reassembled_in"), told(rows, "message.length")) == ({}, {2: ["2"]})


def test_two_passes_without_a_filter_tell_as_much_as_one(tshark: Tshark, tape: Tape) -> None:
    tape.add(datagram("base", "", 0, Hello(node=b"base")), 0.0)
    tape.add(datagram("base", "robot", 0, fragment(1, 0, 2)), 0.1, to="robot")
    tape.add(datagram("base", "robot", 1, fragment(1, 0, 2)), 0.2, to="robot")
    assert "base → " in (text := tshark(tape.path, "-2"))
    assert text.count("[retransmission]") == tshark(tape.path).count("[retransmission]") == 1


def test_fragments_that_contradict_are_marked(tshark: Tshark, tape: Tape) -> None:
    pieces = [fragment(1, 1, 4, data=b"xyz"), fragment(1, 2, 4, data=b"xy"), fragment(1, 2, 5, data=b"xyz")]
    pieces += [fragment(1, 2, 4, priority=6, data=b"xyz"), fragment(1, 2, 4, data=b"xyz")]
    for number, piece in enumerate(pieces):
        tape.add(datagram("base", "robot", number, piece), 0.1 * number, to="robot")
    assert tshark.experts(tape.path) == {"Contradicts the message's other fragments": 3}


def test_what_a_daemon_drops_changes_nothing(tshark: Tshark, tape: Tape) -> None:
    sound = bytes(datagram("base", "robot", 0, fragment(1, 0, 1)))
    tape.add(sound + b"\xee", to="robot")
    tape.add(sound, 0.1, to="robot")
    tape.add(bytes(datagram("base", "", 0, Hello(node=b"base"))) + b"\xee", 0.2)
    rows = tshark.rows(tape.path, "udp_mesh.duplicate_of", "udp_mesh.sender", "udp_mesh.bad")
    assert told(rows, "duplicate_of") == {}
    assert told(rows, "bad") == {1: ["unknown_frame"], 3: ["unknown_frame"]}
    assert {row["udp_mesh.sender"][0] for row in rows} == {f"{EPOCHS['base'] & 0xFFFFFFFF:08x}"}


def inversion_story(tape: Tape, *, to: str = "robot", second_s: float = 0.02, direction: int = 0) -> None:
    """An urgent message of two fragments, and a less urgent one between them."""
    tape.add(datagram("base", "robot", 0, fragment(1, 0, 2, priority=1)), 0.0, to="robot", direction=direction)
    tape.add(datagram("base", to, 1, fragment(2, 0, 1, priority=7)), 0.01, to=to, direction=direction)
    tape.add(datagram("base", "robot", 2, fragment(1, 1, 2, priority=1)), second_s, to="robot", direction=direction)
    tape.add(datagram("base", "robot", 3, fragment(3, 0, 1, priority=7)), 0.03, to="robot", direction=direction)


def test_a_less_urgent_fragment_before_an_urgent_ones_last_is_an_inversion(tshark: Tshark, tape: Tape) -> None:
    inversion_story(tape)
    (row,) = tshark.rows(tape.path, *INVERSION, where="udp_mesh.inversion")
    assert row == {
        "frame.number": ["2"],
        "udp_mesh.inversion": ["1"],
        "udp_mesh.inversion.message_id": ["1"],
        "udp_mesh.inversion.priority": ["1"],
        "udp_mesh.inversion.done_in": ["3"],
        "udp_mesh.inversion.waited": ["0.010000000"],
    }
    assert tshark.experts(tape.path) == {"Priority inversion": 1}


def test_what_is_no_inversion(tshark: Tshark, new_tape: Callable[[], Tape]) -> None:
    other, received, unfinished, late = (new_tape() for _ in range(4))
    inversion_story(other, to="uav")  # whose window may be all that is open
    inversion_story(received, direction=INBOUND)  # here a loss looks like waiting
    unfinished.add(datagram("base", "robot", 0, fragment(1, 0, 2, priority=1)), 0.0, to="robot")
    unfinished.add(datagram("base", "robot", 1, fragment(2, 0, 1, priority=7)), 0.1, to="robot")
    late.add(datagram("base", "robot", 0, fragment(2, 0, 1, priority=7)), 0.0101, to="robot")
    urgent = fragment(1, 0, 1, priority=1, data=traffic(0.0095))  # 0.6 ms before: within the grace
    late.add(datagram("base", "robot", 1, urgent), 0.0102, to="robot")
    for tape in (other, received, unfinished, late):
        assert tshark.rows(tape.path, where="udp_mesh.inversion") == []
    words = ("-o", "udp_mesh.grace_us:500")
    assert len(tshark.rows(late.path, where="udp_mesh.inversion", words=words)) == 1


def test_netlabs_traffic_counts_from_its_publication(tshark: Tshark, tape: Tape) -> None:
    tape.add(datagram("base", "robot", 0, fragment(2, 0, 1, priority=7)), 0.0, to="robot")
    tape.add(datagram("base", "robot", 1, fragment(3, 0, 1, priority=7)), 0.3, to="robot")
    urgent = fragment(1, 0, 1, priority=1, data=traffic(0.1))
    tape.add(datagram("base", "robot", 2, urgent), 0.4, to="robot")
    rows = tshark.rows(tape.path, "udp_mesh.inversion.waited", where="udp_mesh.inversion")
    assert rows == [{"frame.number": ["2"], "udp_mesh.inversion.waited": ["0.200000000"]}]


def test_filters_and_figures_that_people_type(tshark: Tshark, tape: Tape) -> None:
    tape.add(datagram("base", "robot", 0, fragment(1, 0, 1, priority=1), Floor(message_id=1)), to="robot")
    tape.add(datagram("base", "robot", 1, fragment(2, 0, 1, priority=7)), 0.1, to="robot")
    tape.add(datagram("robot", "base", 0, Ack(largest=1, first_range=1)), 0.2, source="robot", to="base")
    found = {where: [row["frame.number"][0] for row in tshark.rows(tape.path, where=where)] for where in (
        'udp_mesh.topic == "map"', "udp_mesh.priority < 3", "udp_mesh.acked_after > 0.15", "udp_mesh.ack.delay == 0",
        'udp_mesh.bad || udp_mesh.flags.sealed == 1',
    )}  # fmt: skip
    assert list(found.values()) == [["1", "2"], ["1"], ["1"], ["3"], []]
    graph = "io,stat,1,AVG(udp_mesh.acked_after)udp_mesh.acked_after && udp_mesh"
    assert "0.150000" in tshark(tape.path, "-2", "-q", "-Y", "udp_mesh", "-z", graph)
