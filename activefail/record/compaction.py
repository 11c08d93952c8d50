"""Compaction: merges many small segments into a few large ones, at a logarithmic cost per design.

A file per batch is slow to open: each takes milliseconds. A single growing file is slow to commit: each batch rewrites
all data. So segments are merged by levels, as in log-structured stores [ONeilEtAl1996]: 64 of one level become one of
the next, and each design is rewritten only a few times.
"""

import json
from collections.abc import Sequence
from itertools import accumulate, groupby, takewhile

from activefail.record.segment import ASKED_ENTRY, CORRECTED_ENTRY, Segment

COMPACT_AT = 64
"""Number of segments of one level that are merged into one."""

LARGEST = 2**19
"""Most designs in a merged segment: about 90 MB with nine variables and twelve margins, merged in a second or two."""


def level(segment: Segment) -> int:
    """The level of a segment by its batches: 0 below 64, 1 below 64², ..."""
    batches, merges = len(segment.batches), 0
    while batches >= COMPACT_AT:
        batches //= COMPACT_AT
        merges += 1
    return merges


def due(segments: Sequence[Segment]) -> Sequence[Segment]:
    """The segments of a record to merge next: at least 64 of one level, or none.

    Only the newest segments, back to one of another level, are examined: older ones were examined when they were new.
    """
    if not segments:
        return ()
    newest = level(segments[-1])
    run = list(takewhile(lambda segment: level(segment) == newest, reversed(segments)))[::-1]
    designs = accumulate(segment.last + 1 - segment.first for segment in run)
    mergeable = run[: sum(1 for _ in takewhile(lambda total: total <= LARGEST, designs))]
    return mergeable if len(mergeable) >= COMPACT_AT else ()


def merge(segments: Sequence[Segment]) -> Segment:
    """One segment with the batches of consecutive segments."""
    provenance = {}
    for key in sorted({key for segment in segments for key in segment.provenance}):
        if key in (ASKED_ENTRY, CORRECTED_ENTRY):
            # It differs from batch to batch; only the last value is ever read.
            provenance[key] = next(one.provenance[key] for one in reversed(segments) if key in one.provenance)
            continue
        texts = [
            item for segment in segments for item in history(segment.provenance.get(key, ""), segment.first).items()
        ]
        # If an entry changed in between, the merged file names the design from which each value holds.
        changes = {next(run)[0]: text for text, run in groupby(texts, key=lambda item: item[1])}
        provenance[key] = next(iter(changes.values())) if len(changes) == 1 else json.dumps(changes)
    start = segments[0]
    batches = tuple(batch for segment in segments for batch in segment.batches)
    return Segment(start.settings, start.schema, start.first, start.before, batches, provenance)


def history(text: str, first: int) -> dict[int, str]:
    """The values of an entry of a segment's provenance, by the first design for which each holds."""
    if not text.startswith("{"):
        return {first: text}
    return {int(design): entry for design, entry in json.loads(text).items()}
