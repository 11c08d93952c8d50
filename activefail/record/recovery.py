"""Reads and checks the segments of a run folder, joins them to one chain, and clears away what interruptions left."""

import difflib
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields
from pathlib import Path

from activefail.errors import DamagedError, StoreError
from activefail.files import TEMPORARY, sync_folder
from activefail.record.batch import Schema
from activefail.record.layout import FOLDERS, SEGMENTS
from activefail.record.segment import Segment, decode_segment
from activefail.visible import visible

QUARANTINE = ".quarantine"


def plain_files(folder: Path) -> list[str]:
    """Names of the regular files in a folder, sorted; empty if the folder does not exist.

    Raises:
        StoreError: if the folder cannot be read.
    """
    try:
        with os.scandir(folder) as entries:
            return sorted(entry.name for entry in entries if entry.is_file(follow_symlinks=False))
    except FileNotFoundError:
        return []  # copying a run folder may drop its empty folders
    except OSError as error:
        raise StoreError(f"Cannot read {folder}: {error.strerror or error}.") from error


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Name the file in errors that stop its reading; the caller handles a damaged or missing file."""
    try:
        yield
    except (DamagedError, FileNotFoundError):
        raise
    except StoreError as error:
        raise StoreError(f"{path} {error}") from error
    except OSError as error:
        raise StoreError(f"Cannot read {path}: {error.strerror or error}.") from error
    except MemoryError:
        raise StoreError(f"Cannot read {path}: it does not fit into memory.") from None


def is_segment(name: str) -> bool:
    """Whether a file's name is that of a segment."""
    return re.fullmatch(r"\d{9,}-\d{9,}\.h5", name) is not None


def read_segments(folder: Path) -> tuple[list[Segment], dict[str, str]]:
    """The segments in a folder, and the damaged files with the reasons.

    Raises:
        StoreError: if a file cannot be read or another version wrote it.
    """
    read: dict[str, Segment | str] = {}
    # Repeat until the listing is stable: a reader holds no lock, and a writer may commit or compact meanwhile.
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
    """Check that segments belong to the campaign with these settings and this schema (the first segment's if None).

    Raises:
        StoreError: naming the differences.
    """
    for segment in segments:
        if segment.settings != settings:
            lines = difflib.unified_diff(
                segment.settings.splitlines(), settings.splitlines(), f"in {segment.name}", "campaign.toml", lineterm=""
            )
            raise StoreError(
                f"The settings were changed after the campaign began: campaign.toml differs from the settings "
                f"in segments/{segment.name}. Restore the frozen copy (the segment holds its text, in the dataset "
                f"'settings'), or start a new campaign in another folder. Changes:\n"
                + ("\n".join(map(visible, lines)) or "only line endings")
            )
        schema = schema or segment.schema
        for field in fields(schema):
            expected, actual = getattr(schema, field.name), getattr(segment.schema, field.name)
            if expected != actual:
                raise StoreError(
                    f"The {field.name} are not those of the campaign: segments/{segment.name} holds {actual}, "
                    f"the settings give {expected}."
                )


@dataclass(frozen=True)
class Recovery:
    """The chain of a folder's segments, and the files that can be removed without losing a design."""

    chain: tuple[Segment, ...]
    covered: tuple[str, ...]  # inputs of an interrupted compaction
    damaged: Mapping[str, str]  # name -> reason; none precedes a valid segment


def recover(segments: Sequence[Segment], damaged: Mapping[str, str], start: str) -> Recovery:
    """The longest chain of segments from design 0; of several candidates the longest segment is taken.

    Raises:
        StoreError: if designs are missing before valid segments, or segments contradict each other.
    """
    chain: list[Segment] = []
    digests = {0: start}
    end = 0
    while candidates := [segment for segment in segments if segment.first == end and segment.before == digests[end]]:
        chain.append(max(candidates, key=lambda segment: segment.last))
        digests |= chain[-1].chain
        end = max(digests)
    covered, beyond, strays = [], [], {}
    for segment in segments:
        if segment.first > end:
            beyond.append(segment)
        elif segment.first == end:
            strays[segment.name] = "does not follow the last batch of this campaign"
        elif segment in chain:
            continue
        elif segment.chain.items() <= digests.items():
            covered.append(segment.name)
        else:
            rivals = [other.name for other in chain if other.first <= segment.last and segment.first <= other.last]
            raise StoreError(
                f"Two writers wrote different designs under the same ids: {segment.name} and {', '.join(rivals)}. "
                f"Nothing was changed. Decide which file to keep, and move the others out of segments/."
            )
    damaged = {**damaged, **strays}
    if beyond:
        later = min(beyond, key=lambda segment: segment.first)
        reasons = "; ".join(f"{name} {reason}" for name, reason in sorted(damaged.items()))
        raise StoreError(
            f"Designs {end} to {later.first - 1} are missing ({reasons or 'no file contains them'}), but later ones "
            f"exist in {', '.join(sorted(segment.name for segment in beyond))}. Nothing was changed. Restore the "
            f"missing file from a copy, or move the later files out of segments/ to continue from design {end}."
        )
    return Recovery(tuple(chain), tuple(covered), damaged)


def quarantine_of(path: Path) -> Path:
    """The name under which a file is quarantined, which no older one has."""
    aside = path.with_name(path.name + QUARANTINE)
    number = 1
    while os.path.lexists(aside):
        number += 1
        aside = path.with_name(f"{path.name}{QUARANTINE}-{number}")
    return aside


def set_aside(path: Path, reason: str) -> str:
    """Quarantine a damaged file, never over an older one; returns the warning for the user.

    Raises:
        StoreError: with the system's reason.
    """
    aside = quarantine_of(path)
    try:
        os.rename(path, aside)
    except OSError as error:
        raise StoreError(f"Cannot rename {path}: {error.strerror or error}.") from error
    return f"{path.parent.name}/{path.name} {reason}; it was renamed to {aside.name} and is not used."


def clear_remains(folder: Path, recovery: Recovery) -> list[str]:
    """Clear away what interruptions left in a run folder, as its only writer; returns warnings for the user.

    Temporary files and the inputs of compactions are removed, damaged segments are quarantined, and folders that are
    missing are created.

    Raises:
        StoreError: with the system's reason.
    """
    segments, warnings = folder / SEGMENTS, []
    try:
        for name in FOLDERS:
            with suppress(FileExistsError):
                os.mkdir(folder / name)
        for parent in (folder, *(folder / name for name in FOLDERS)):
            for name in plain_files(parent):
                if name.startswith(TEMPORARY):
                    os.unlink(parent / name)
        warnings += [set_aside(segments / name, reason) for name, reason in sorted(recovery.damaged.items())]
        # The merged segment must be durable under its name before its inputs are removed.
        sync_folder(segments)
        for name in recovery.covered:
            os.unlink(segments / name)
    except OSError as error:
        raise StoreError(f"Cannot write to {folder}: {error.strerror or error}.") from error
    sync_folder(segments)
    sync_folder(folder)
    return warnings
