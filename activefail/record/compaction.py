"""Compaction: many small segments become a few large ones, at a cost per design that grows with the logarithm alone.

Of a hundred thousand files each takes milliseconds to open; of one file that grows with every batch each commit would
rewrite all. So segments are merged by levels, as log-structured stores do [ONeilEtAl1996]: 64 of one level become
one of the next, and no design is rewritten more than a few times.
"""

import json
from collections.abc import Sequence
from itertools import accumulate, groupby, takewhile

from activefail.record.segment import Segment

COMPACT_AT = 64
"""Segments of one level that are merged into one."""

LARGEST = 2**19
"""Most designs of a merged segment: some 90 MB of nine variables and twelve margins, merged in a second or two."""


def level(segment: Segment) -> int:
    """How often segments like this one were merged: 0 below 64 batches, 1 below 64², ..."""
    batches, times = len(segment.batches), 0
    while batches >= COMPACT_AT:
        batches //= COMPACT_AT
        times += 1
    return times


def due(segments: Sequence[Segment]) -> Sequence[Segment]:
    """Of a record's segments those that are to be merged next: at least 64 of one level, or none.

    Only the newest segments are looked at, up to one of another level: what is older was looked at when it was new.
    """
    if not segments:
        return ()
    newest = level(segments[-1])
    run = list(takewhile(lambda segment: level(segment) == newest, reversed(segments)))[::-1]
    designs = accumulate(segment.last + 1 - segment.first for segment in run)
    fitting = run[: sum(1 for _ in takewhile(lambda total: total <= LARGEST, designs))]
    return fitting if len(fitting) >= COMPACT_AT else ()


def merge(segments: Sequence[Segment]) -> Segment:
    """One segment with the batches of consecutive ones."""
    provenance = {}
    for key in sorted({key for segment in segments for key in segment.provenance}):
        texts = [
            item for segment in segments for item in history(segment.provenance.get(key, ""), segment.first).items()
        ]
        # Where the programs changed in between, the merged file says from which design on.
        changes = {next(run)[0]: text for text, run in groupby(texts, key=lambda item: item[1])}
        provenance[key] = next(iter(changes.values())) if len(changes) == 1 else json.dumps(changes)
    start = segments[0]
    batches = tuple(batch for segment in segments for batch in segment.batches)
    return Segment(start.settings, start.schema, start.first, start.before, batches, provenance)


def history(text: str, first: int) -> dict[int, str]:
    """What an entry of a segment's provenance says, by the design from which on it holds."""
    if not text.startswith("{"):
        return {first: text}
    return {int(design): entry for design, entry in json.loads(text).items()}
