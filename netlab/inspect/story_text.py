"""One message's story: a page of text, an object, or its parts as rows."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from dataclasses import asdict

from netlab.inspect.table import Column, Table
from netlab.traces.explain import milliseconds
from netlab.traces.sentences import because, fate_text
from netlab.traces.story import FragmentStory, HopStory, Part, Share, Story, Transmission
from netlab.traces.waiting import behind, merged_ahead, size_text

_MOST_PARTS = 4  # lines of one cause
_MOST_FRAGMENTS = 12
_BAR = 20
_LEAST_S = 0.00005
_LEAST_SHARE = 0.01  # of which the details are worth lines


def story_text(story: Story, *, width: int) -> str:
    """What became of a message, why, where its time went, and the life of its fragments."""
    head = f"{story}  priority {story.stream.priority}, {size_text(story.size_bytes)}"
    head += (
        f", {story.fragment_count} fragment{'s' if story.fragment_count != 1 else ''}" if story.fragment_count else ""
    )
    lines = [head, *textwrap.wrap(fate_text(story), width), "", *textwrap.wrap(because(story), width)]
    if story.parts:
        lines += ["", "where the time went", *_shares(story, width)]
    if story.fragments:
        lines += ["", f"its way  {_way(story)}", "", "fragments", *_fragments(story, width)]
    notes = [note for note in story.notes if note not in because(story)]
    return "\n".join([*lines, *(f"note: {note}" for note in notes)])


def _way(story: Story) -> str:
    if story.critical_index is None or not any(fragment.arrived_s is not None for fragment in story.fragments):
        return "none of it is known to have arrived"
    return " > ".join((story.stream.source, *story.relays, story.stream.destination))


def _shares(story: Story, width: int) -> Iterator[str]:
    told = [share for share in story.shares if share.duration_s >= _LEAST_S or share.ratio >= _LEAST_SHARE]
    for share in told:
        bar = "#" * round(_BAR * share.ratio)
        name = share.cause.value.replace("_", " ")
        yield f"  {name:<13}{milliseconds(share.duration_s):>11} {100 * share.ratio:4.0f} %  {bar}".rstrip()
        for line in _told(share) if share.ratio >= _LEAST_SHARE else ():
            yield from textwrap.wrap(line, width, initial_indent=" " * 6, subsequent_indent=" " * 8)
    whole_s = story.ended_s - story.published_s
    yield f"  {'together':<13}{milliseconds(whole_s):>11}  100 %"


def _told(share: Share) -> Iterator[str]:
    """What is worth saying of the parts of one cause; what they waited for is summed up."""
    ahead = [entry for part in share.parts for entry in part.ahead]
    if ahead:
        parts = f", in {len(share.parts)} turns" if len(share.parts) > 1 else ""
        yield f"{_times(share.parts)} {behind(merged_ahead(ahead))}{parts}"
        return
    groups: dict[str, list[Part]] = {}
    for part in share.parts:
        if part.words:
            groups.setdefault(part.words, []).append(part)
    ranked = sorted(groups.values(), key=lambda group: -sum(part.duration_s for part in group))[:_MOST_PARTS]
    for alike in sorted(ranked, key=lambda group: group[0].from_s):
        total_s = sum(part.duration_s for part in alike)
        turns = f" ({len(alike)} times, {milliseconds(total_s)})" if len(alike) > 1 else ""
        yield f"{_times(tuple(alike))} {alike[0].words}{turns}"
    if len(groups) > len(ranked):
        yield f"... and {len(groups) - len(ranked)} more (--format json has all)"


def _times(parts: tuple[Part, ...]) -> str:
    start, end = f"{parts[0].from_s:.3f}", f"{parts[-1].to_s:.3f}"
    return f"{start} s" if start == end else f"{start}-{end} s"


def _fragments(story: Story, width: int) -> Iterator[str]:
    shown = _worth_showing(story)
    for fragment in shown:
        mark = ">" if fragment.index == story.critical_index else " "
        number = f"{fragment.index + 1}/{story.fragment_count}"
        for first, sent in zip([True] + [False] * len(fragment.transmissions), fragment.transmissions, strict=False):
            yield from _transmission(f"{mark} {number if first else '':<9}", sent, width)
    hidden = len(story.fragments) - len(shown)
    if hidden:
        yield f"  ... and {hidden} more fragments (--format json has all)"


def _worth_showing(story: Story) -> list[FragmentStory]:
    """Those with something to tell: the last to arrive, those sent again or missing, the first one."""
    told = [
        fragment
        for fragment in story.fragments
        if fragment.index in (0, story.critical_index) or len(fragment.transmissions) > 1 or fragment.arrived_s is None
    ]
    critical = [fragment for fragment in told if fragment.index == story.critical_index]
    others = [fragment for fragment in told if fragment.index != story.critical_index]
    return sorted([*critical, *others[:_MOST_FRAGMENTS]], key=lambda fragment: fragment.index)


def _transmission(label: str, sent: Transmission, width: int) -> Iterator[str]:
    text = f"{label} #{sent.packet_number:<6} {sent.left_s:9.3f} s  {sent.sending.value:<6} {_end(sent)}"
    yield from textwrap.wrap(text.rstrip(), width, subsequent_indent=" " * 14, drop_whitespace=True) or [text]
    if len(sent.hops) > 1 and sent.arrived_s is not None:
        for hop in sent.hops:
            yield f"{'':<14}{_hop(hop)}"


def _end(sent: Transmission) -> str:
    if sent.arrived_s is not None:
        stale = "" if sent.counts else " (for a daemon that forgot it)"
        acked = f", acknowledged {sent.acked_s:.3f} s" if sent.acked_s is not None else ""
        return f"arrived {sent.arrived_s:.3f} s{stale}{acked}"
    fates = "; ".join(f"{hop.verdict or 'did not arrive'} on {hop.sender} > {hop.receiver}" for hop in sent.hops)
    return fates or ("not seen to arrive" if sent.acked_s is None else f"acknowledged {sent.acked_s:.3f} s")


def _hop(hop: HopStory) -> str:
    arrived = f"{hop.arrived_s:.3f} s" if hop.arrived_s is not None else hop.verdict
    radio = f", sent {hop.attempts} times" if hop.attempts > 1 else ""
    radio += f", {hop.rssi_dbm} dBm" if hop.rssi_dbm is not None else ""
    return f"{hop.left_s:.3f} s {hop.sender} > {hop.receiver} {arrived}{radio}"


def story_json(story: Story) -> dict[str, object]:
    """The story as plain values; times in scenario seconds."""
    body: dict[str, object] = asdict(story)
    return body | {
        "kind": "story",
        "latency_s": story.latency_s,
        "cause": story.cause,
        "because": because(story),
        "fate_text": fate_text(story),
        "shares": [
            {"cause": share.cause, "duration_s": share.duration_s, "ratio": share.ratio} for share in story.shares
        ],
    }


def story_table(story: Story) -> Table:
    """The parts of the latency as rows."""
    keys = ("topic", "seq", "source", "destination", "cause", "from_s", "to_s", "duration_s", "words")
    name = {"topic": story.stream.topic, "seq": story.seq}
    name |= {"source": story.stream.source, "destination": story.stream.destination}
    rows = [
        {
            **name,
            "cause": part.cause.value,
            "from_s": part.from_s,
            "to_s": part.to_s,
            "duration_s": part.duration_s,
            "words": part.words,
        }
        for part in story.parts
    ]
    return Table(str(story), [Column(key) for key in keys], rows)
