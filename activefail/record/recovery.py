"""What a run folder's files come to: read, checked against the campaign, and put in one chain."""

import difflib
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path

from activefail.errors import DamagedError, StoreError
from activefail.record.batch import Schema
from activefail.record.segment import Segment, decode_segment
from activefail.visible import visible

QUARANTINE = ".quarantine"


def plain_files(folder: Path) -> list[str]:
    """Names of the plain files in a folder, sorted; none if there is no such folder.

    Raises:
        StoreError: if it cannot be read.
    """
    try:
        with os.scandir(folder) as entries:
            return sorted(entry.name for entry in entries if entry.is_file(follow_symlinks=False))
    except FileNotFoundError:
        return []  # a copied run folder may have lost its empty folders
    except OSError as error:
        raise StoreError(f"Cannot read {folder}: {error.strerror or error}.") from error


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Name the file in what stops its reading; that it is damaged or gone is for the caller to judge."""
    try:
        yield
    except (DamagedError, FileNotFoundError):
        raise
    except StoreError as error:
        raise StoreError(f"{path} {error}") from error
    except OSError as error:
        raise StoreError(f"Cannot read {path}: {error.strerror or error}.") from error
    except MemoryError:
        raise StoreError(f"Cannot read {path}: it does not fit into the memory.") from None


def is_segment(name: str) -> bool:
    """Whether a file's name is that of a segment."""
    return re.fullmatch(r"\d{9,}-\d{9,}\.h5", name) is not None


def read_segments(folder: Path) -> tuple[list[Segment], dict[str, str]]:
    """The segments in a folder, and the files that are damaged with their reasons.

    Raises:
        StoreError: if a file cannot be read or was written in another version.
    """
    read: dict[str, Segment | str] = {}
    # Until the folder stands still: a reader holds no lock, and a writer may commit or compact meanwhile.
    while (names := {name for name in plain_files(folder) if is_segment(name)}) != read.keys():
        read = {name: read[name] for name in names & read.keys()}
        for name in sorted(names - read.keys()):
            try:
                with reading(folder / name):
                    read[name] = decode_segment(name, (folder / name).read_bytes())
            except FileNotFoundError:
                continue
            except DamagedError as error:
                read[name] = str(error)
    segments = [value for value in read.values() if isinstance(value, Segment)]
    return segments, {name: value for name, value in read.items() if isinstance(value, str)}


def check_campaign(segments: Sequence[Segment], settings: str, schema: Schema | None) -> None:
    """Check that segments are of the campaign with these settings and this schema (of the first one if None).

    Raises:
        StoreError: if they are not, with what differs.
    """
    for segment in segments:
        if segment.settings != settings:
            lines = difflib.unified_diff(
                segment.settings.splitlines(), settings.splitlines(), f"in {segment.name}", "campaign.toml", lineterm=""
            )
            raise StoreError(
                f"The settings were changed after the campaign began: the SHA-256 of campaign.toml is not the one in "
                f"segments/{segment.name}. Restore the frozen copy (the segment holds its text, in the dataset "
                f"'settings'), or begin a new campaign in another folder. What was changed:\n"
                + ("\n".join(map(visible, lines)) or "only line ends")
            )
        schema = schema or segment.schema
        for field in fields(schema):
            ours, theirs = getattr(schema, field.name), getattr(segment.schema, field.name)
            if ours != theirs:
                raise StoreError(
                    f"The {field.name} are not those of the campaign: segments/{segment.name} holds {theirs}, "
                    f"the settings give {ours}."
                )


@dataclass(frozen=True)
class Recovery:
    """What a folder's segments come to: the chain, and what can go without losing a design."""

    chain: tuple[Segment, ...]
    covered: tuple[str, ...]  # inputs of a compaction that was interrupted
    damaged: Mapping[str, str]  # name -> reason; none of them stands before a valid segment


def recover(segments: Sequence[Segment], damaged: Mapping[str, str], start: str) -> Recovery:
    """The longest chain of segments from design 0 on, where the widest one wins.

    Raises:
        StoreError: if designs are missing before valid segments, or segments contradict each other.
    """
    chain: list[Segment] = []
    digests = {0: start}
    end = 0
    while fits := [segment for segment in segments if segment.first == end and segment.before == digests[end]]:
        chain.append(max(fits, key=lambda segment: segment.last))
        digests |= chain[-1].chain
        end = max(digests)
    covered, beyond, strays = [], [], {}
    for segment in segments:
        if segment.first > end:
            beyond.append(segment)
        elif segment.first == end:
            strays[segment.name] = "does not continue the chain of this campaign"
        elif segment in chain:
            continue
        elif segment.chain.items() <= digests.items():
            covered.append(segment.name)
        else:
            rivals = [other.name for other in chain if other.first <= segment.last and segment.first <= other.last]
            raise StoreError(
                f"Two writers have written different designs under the same ids: {segment.name} against "
                f"{', '.join(rivals)}. Nothing was changed. Move the wrong one out of segments/ to go on."
            )
    damaged = {**damaged, **strays}
    if beyond:
        later = min(beyond, key=lambda segment: segment.first)
        bad = "; ".join(f"{name} {reason}" for name, reason in sorted(damaged.items()))
        raise StoreError(
            f"Designs {end} to {later.first - 1} are missing ({bad or 'there is no file with them'}), yet there "
            f"{'are' if len(beyond) > 1 else 'is'} {', '.join(sorted(segment.name for segment in beyond))}. Nothing "
            f"was changed. Restore the missing file from a copy, or move the later ones out of segments/ to go on "
            f"from design {end}."
        )
    return Recovery(tuple(chain), tuple(covered), damaged)


def set_aside(path: Path, reason: str) -> str:
    """Rename a bad file, never over an older one; the warning that tells of it.

    Raises:
        StoreError: with the system's reason.
    """
    aside = path.with_name(path.name + QUARANTINE)
    number = 1
    while os.path.lexists(aside):
        number += 1
        aside = path.with_name(f"{path.name}{QUARANTINE}-{number}")
    try:
        os.rename(path, aside)
    except OSError as error:
        raise StoreError(f"Cannot rename {path}: {error.strerror or error}.") from error
    return f"{path.parent.name}/{path.name} {reason}; it was renamed to {aside.name} and is not used."
