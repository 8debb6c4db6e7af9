"""The story of a message in words: what became of it, and why it was late."""

from __future__ import annotations

from netlab.traces.causes import INHERENT, Cause
from netlab.traces.explain import milliseconds
from netlab.traces.story import Fate, Share, Story

_LATE = {
    Cause.HANDOVER: "it took long to reach the daemon of its sender",
    Cause.RATE_LIMIT: "the rate limit of its topic held it back",
    Cause.QUEUE: "it waited in its sender's queue",
    Cause.PACING: "its sender's window or pace had no room",
    Cause.YIELDING: "its sender left the medium to a more urgent backlog elsewhere",
    Cause.SENDING: "its own fragments took their time to leave",
    Cause.LOSS: "frames were lost on the way",
    Cause.QUEUE_FULL: "the link's queue was full, and what it dropped was sent again",
    Cause.OUTAGE: "the link was cut",
    Cause.OUT_OF_RANGE: "the nodes were out of range of each other",
    Cause.RESTART: "a daemon was restarted",
    Cause.PEER_ABSENT: "the destination was offline",
    Cause.RECONNECT: "the nodes had yet to find each other again",
    Cause.LINK_QUEUE: "it waited in the link's queue or for the channel",
    Cause.RADIO_RETRIES: "the radio had to send it several times until it was heard",
    Cause.TRANSMISSION: "the frame itself was long on the link",
    Cause.PROPAGATION: "the link's delay",
    Cause.RELAY: "it waited inside nodes that passed it on",
    Cause.REASSEMBLY: "the receiver was slow to hand it over",
    Cause.UNEXPLAINED: "the capture does not say why",
}
_ENDINGS = {
    "superseded": "A newer one took its place meanwhile",
    "expired": "Its lifetime ended first",
    "queue_full": "The queue ran full and it had to go",
    "lost": "It was lost, and best effort does not send again",
    "peer_restarted": "All of it had left for a daemon that is gone, so its fate is unknown",
}
_LEAST_SHARE = 0.05  # of which a further cause is worth a word


def fate_text(story: Story) -> str:
    """What became of it, with times."""
    published = f"published {story.published_s:.3f} s"
    if story.delivered_s is not None and story.latency_s is not None:
        return f"{published}, delivered {story.delivered_s:.3f} s: {milliseconds(story.latency_s)}{_against(story)}"
    match story.fate:
        case Fate.REFUSED:
            return f"{published}, refused at once: {story.reason}"
        case Fate.DROPPED:
            after = milliseconds(story.ended_s - story.published_s)
            return f"{published}, given up by its sender {story.ended_s:.3f} s ({after} later): {story.reason}"
        case Fate.NOT_HANDED_OVER:
            whole = f"acknowledged {story.ended_s:.3f} s"
            return f"{published}, {whole}: the receiving daemon had it, the subscribing process did not get it"
        case Fate.LOST:
            return f"{published}, lost: {story.reason}"
        case _:
            return f"{published}, not delivered by the end of the capture ({story.ended_s:.3f} s)"


def because(story: Story) -> str:
    """Why it was late, or why it did not arrive, the causes ranked with what each took; in one or two sentences."""
    if story.fate is Fate.REFUSED:
        return f"Never sent: {'; '.join(story.notes)}." if story.notes else "Never sent."
    if story.cause is None:
        return _not_late(story)
    ranked = [share for share in story.shares if share.cause not in INHERENT]
    first, others = ranked[0], [share for share in ranked[1:] if share.ratio >= _LEAST_SHARE]
    again = " and sent again" if first.cause is Cause.LOSS and story.fate is Fate.DELIVERED else ""
    text = f"{_opening(story)}: {_LATE[first.cause]}{again} ({_amount(first)})."
    if others:
        text += f" Also {', '.join(f'{_short(share.cause)} ({_amount(share)})' for share in others)}."
    return text


def _opening(story: Story) -> str:
    return "Late" if story.fate is Fate.DELIVERED else _ENDINGS.get(story.reason, "It did not get there")


def _not_late(story: Story) -> str:
    if not story.shares:
        return "There is nothing to explain."
    first = story.shares[0]
    return f"Nothing held it up: {_short(first.cause)} is most of it ({_amount(first)})."


def _amount(share: Share) -> str:
    return f"{milliseconds(share.duration_s)}, {100 * share.ratio:.0f} %"


def _short(cause: Cause) -> str:
    return cause.value.replace("_", " ")


def _against(story: Story) -> str:
    if not story.typical_s or story.latency_s is None:
        return ""
    times = story.latency_s / story.typical_s
    factor = f", {times:.0f} times that" if times >= 2 else ""
    return f" (the stream's median is {milliseconds(story.typical_s)}{factor})"
