"""Reads a run folder by docs/reference/run-folder.md alone; activefail also checks what the events say."""

import hashlib
import json
import re
from pathlib import Path

import numpy as np

FIRST = b"activefail-journal, format 2".ljust(31) + b"\n"
RESULTS = ("outcome", "cause", "margins", "seconds")


def sha256(data):
    """A digest in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def entry(data, at, before):
    """Event, digest, content and end of the entry at a place; None if it is damaged."""
    end = data.find(b"\n", at) + 1
    line = re.match(rb"activefail ([0-9a-f]{64}) (\d+) (.*)\n", data[at:end])
    if line is None or end + int(line[2]) > len(data):
        return None
    stop = end + int(line[2])
    content = sha256(data[at + 76 : stop])
    if sha256((before + content).encode()) != line[1].decode():
        return None
    kind, attributes, types = json.loads(line[3])
    arrays = {
        name: np.frombuffer(data, dtype, int(np.prod(shape)), end + place).reshape(shape)
        for name, dtype, shape, place in types
    }
    return (kind, attributes, arrays), line[1].decode(), content, stop


def read_events(folder):
    """All events of a run folder, with their contents."""
    data, events, at, digest = (Path(folder) / "journal").read_bytes(), [], len(FIRST), ""
    if not data.startswith(FIRST):
        raise ValueError("another format")
    while at < len(data):
        found = entry(data, at, digest)
        if found is None:
            if re.search(rb"activefail [0-9a-f]{64} \d+ \[", data[at + 1 :]):
                raise ValueError(f"damaged at byte {at}")
            break
        event, digest, content, at = found
        events.append((*event, content))
    if events[0][1]["settings"].encode() != (Path(folder) / "campaign.toml").read_bytes():
        raise ValueError("other settings")
    return events


def read_record(folder):
    """The schema, the batches with their corrections, the handed-out designs, the sets and the results."""
    batches, asked, sets, results = [], [], {}, {}
    for kind, attributes, arrays, _ in read_events(folder):
        if kind == "campaign":
            schema = attributes["schema"]
        elif kind == "batch":
            copies = {name: array.copy() for name, array in arrays.items()}
            batches.append({"iteration": attributes["iteration"], **copies})
        elif kind == "corrected":
            rows = [(batch, row) for batch in batches for row in range(len(batch["outcome"]))]
            for k, place in enumerate(arrays["place"]):
                batch, row = rows[place]
                for name in RESULTS:
                    batch[name][row] = arrays[name][k]
        elif kind == "asked":
            columns = [array.tolist() for array in arrays.values()]
            asked += [dict(zip(arrays, row, strict=True)) for row in zip(*columns, strict=True)]
        elif kind == "dropped":
            for design in asked:
                design["dropped"] |= int(design["id"] in arrays["id"])
        elif kind == "set":
            sets[attributes["name"]] = arrays
        elif kind == "result":
            results[tuple(attributes["of"])] = attributes["value"]
    return schema, batches, asked, sets, results


def read_states(folder):
    """The arrays of each saved state, and the digest of the record that it learned from, by iteration."""
    found = entry((Path(folder) / "checkpoint.h5").read_bytes(), 0, "")
    if found is None:
        return {}
    _, attributes, arrays = found[0]
    return {
        int(iteration): (record, {n.partition("/")[2]: a for n, a in arrays.items() if n.startswith(f"{iteration}/")})
        for iteration, record in attributes["states"].items()
    }


def digest(folder, through=float("inf")):
    """The digest of a record up to an iteration."""
    chains, ends, iterations, corrections = [""], [0], [], []
    for kind, attributes, arrays, content in read_events(folder):
        if kind == "batch":
            chains.append(sha256((chains[-1] + content).encode()))
            ends.append(ends[-1] + len(arrays["outcome"]))
            iterations.append(attributes["iteration"])
        elif kind == "corrected":
            corrections.append((min(arrays["place"]), content))
    last = max((k + 1 for k, iteration in enumerate(iterations) if iteration <= through), default=0)
    texts = [chains[last], *(content for first, content in corrections if first < ends[last])]
    return sha256(" ".join(texts).encode())
