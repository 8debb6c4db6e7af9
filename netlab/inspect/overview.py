"""The summary of a capture: what it holds, and the figures of its run."""

from __future__ import annotations

import json
from collections.abc import Iterator

from netlab.capture.reader import Capture
from netlab.inspect.questions import Asked
from netlab.inspect.table import Format, csv_lines
from netlab.traces.load import load_trace
from netlab.traces.summary import summary
from netlab.traces.tables import columns, summary_text


def overview(asked: Asked) -> Iterator[str]:
    """The file's topics and the run's figures; as CSV the streams."""
    with Capture.open(asked.file) as capture:
        metadata, counts = capture.metadata, capture.counts()
        notes, length_s = capture.notes, (capture.end_ns - capture.t0_ns) / 1e9
    trace = load_trace(asked.file)
    told = summary(trace)
    if asked.form is Format.JSON:
        head = {"capture": str(asked.file), "metadata": metadata, "messages": dict(sorted(counts.items()))}
        yield json.dumps({**head, "notes": notes, **told})
        return
    for note in notes:
        asked.note(note)
    if asked.form is Format.CSV:
        rows = [_flat(row) for row in told["streams"]]
        yield from (line.rstrip("\n") for line in csv_lines(list(rows[0]) if rows else [], rows))
        return
    words = {key: metadata.get(key) for key in ("engine", "clock", "seed", "duration_s")}
    line = "  ".join(f"{key} {value}" for key, value in words.items() if value)
    yield f"{metadata.get('name', asked.file.name)}  {line}".rstrip()
    end = f"up to {length_s:.3f} s" if counts else "empty"
    yield f"{asked.file}: {asked.file.stat().st_size / 1e6:.1f} MB, {sum(counts.values())} messages, {end}"
    if counts:
        yield "\ntopics"
        yield from (f"  {row}" for row in columns([[name, str(count)] for name, count in sorted(counts.items())]))
    if text := summary_text(trace):
        yield f"\n{text}"


def _flat(row: dict[str, object]) -> dict[str, object]:
    """Give values inside values columns of their own: ``latency_s`` of ``p50`` becomes ``latency_p50_s``."""
    flat: dict[str, object] = {}
    for key, value in row.items():
        if isinstance(value, dict):
            flat |= {f"{key.removesuffix('_s')}_{name}_s": inner for name, inner in value.items()}
        else:
            flat[key] = value
    return flat
