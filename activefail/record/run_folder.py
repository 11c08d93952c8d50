"""The record of a campaign in its run folder: `commit` makes a batch durable, in a chain of immutable files.

    <folder>/campaign.toml              frozen copy of the settings
             segments/<first>-<last>.h5 whole batches, immutable; states can be learned again from them
             state/<iteration>.h5       what was learned; the last three
             asked.h5                   designs that were handed out to be simulated elsewhere
             corrections.h5             results that replaced others
             sets/<name>.h5             designs outside the budget and their results, simulated once
             .lock                      one writer at a time

Every batch extends a chain of digests that starts with the settings and the schema. So a segment that is missing,
altered or from another campaign is detected. Merging segments does not change the chain.
"""

import itertools
import os
import re
import tomllib
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from activefail import __version__
from activefail.errors import DamagedError, InputError, StoreError, SyncError
from activefail.files import TEMPORARY, make_folder, publish, read_regular, replace, sync_folder
from activefail.record import compaction
from activefail.record.asked import LARGEST_ASKED, Asked, decode_asked, encode_asked
from activefail.record.attachments import decode_set, decode_state, encode_set, encode_state
from activefail.record.batch import Batch, Schema, checked_copy
from activefail.record.corrections import (
    LARGEST_CORRECTIONS,
    Corrections,
    corrected,
    correcting,
    decode_corrections,
    encode_corrections,
    record_digest,
)
from activefail.record.layout import (
    ASKED,
    CORRECTIONS,
    LARGEST_SETTINGS,
    LOCK,
    SEGMENTS,
    SETS,
    SETTINGS,
    STATES,
    refuse_links,
    set_file,
    state_file,
)
from activefail.record.lock import FolderLock
from activefail.record.recovery import (
    QUARANTINE,
    check_campaign,
    clear_remains,
    is_segment,
    plain_files,
    quarantine_of,
    read_segments,
    reading,
    recover,
    set_aside,
)
from activefail.record.segment import (
    ASKED_ENTRY,
    CORRECTED_ENTRY,
    Segment,
    chain_start,
    continues,
    encode_segment,
)
from activefail.record.store import STATES_KEPT, check_asked, check_set, checked_state
from activefail.simulators.interface import Results
from activefail.space import Array
from activefail.visible import visible


def _setting(settings: str, key: str) -> str:
    """The value of a key such as "simulator.python" in the text of the settings."""
    value: Any = tomllib.loads(settings)
    for part in key.split("."):
        value = value[part]
    return str(value)


def _short(entry: str) -> str:
    """An entry of the provenance; a digest is abbreviated."""
    return entry[:8] if re.fullmatch("[0-9a-f]{64}", entry) else entry


class _MovedError(StoreError):
    """The folder is no longer under the path that was opened."""


def check_empty(folder: Path, what: str, instead: str) -> None:
    """Check that a folder is empty or missing, except for remains of an interrupted creation.

    Args:
        folder: the folder for something new.
        what: what the folder is for.
        instead: advice if the folder is not empty.

    Raises:
        InputError: if the folder is not empty.
        OSError: if the folder cannot be read.
    """
    entries = sorted(os.listdir(folder)) if folder.exists() else []
    foreign = [name for name in entries if name != LOCK and not name.startswith(TEMPORARY)]
    if foreign:
        raise InputError(
            f"{folder} is not empty (it holds {visible(foreign[0])}): a new {what} needs a new folder. {instead}"
        )


class FolderStore:
    """A record in a run folder, from `create` or `open`; implements `Store`.

    Attributes:
        folder: the run folder.
        settings: the text of campaign.toml.
        schema: the meaning of the columns; None for a record without batches, opened for reading without a schema.
    """

    def __init__(
        self,
        folder: Path,
        settings: str,
        schema: Schema | None,
        lock: FolderLock | None,
        provenance: Mapping[str, str],
        decisive: Collection[str],
    ) -> None:
        self.folder = folder
        self.settings = settings
        self.schema = schema
        self._provenance = {"activefail": __version__, **provenance}
        self._decisive = frozenset(decisive)
        self._lock = lock
        # A fork inherits the lock, and would be a second writer.
        self._pid = os.getpid()
        self._warnings: list[str] = []
        self._shown = 0
        self._rejected: set[int] = set()
        self._segments: list[Segment] = []
        self._asked: Asked | StoreError = Asked.none(0)
        # All that the file lists; not all of them need apply to the batches.
        self._corrections = Corrections.none(schema)
        # What the list of designs says of them.
        self._noted = ""
        self._start = ""
        self._batches: list[Batch] = []
        # With corrections. Built on demand: a commit must not copy all earlier batches.
        self._joined: tuple[tuple[Batch, ...], Corrections] | None = None
        # The reason why this object may not write; empty if it may.
        self._refusal = "" if lock else f"{folder} was opened for reading only."
        if lock and not lock.held:
            self._warn(f"The file system of {folder} has no locks: make sure that only one process writes at a time.")

    @classmethod
    def create(
        cls,
        folder: str | os.PathLike[str],
        settings: str,
        schema: Schema,
        *,
        provenance: Mapping[str, str] | None = None,
        decisive: Collection[str] = (),
    ) -> Self:
        """A new run folder with the frozen settings, open for writing.

        A creation that was interrupted before it wrote campaign.toml can be repeated.

        Args:
            folder: a missing or empty folder.
            settings: the text of campaign.toml.
            schema: the meaning of the columns.
            provenance: versions and digests to record with every batch and set, by name.
            decisive: names in `provenance` of what decides the results of a simulation. A set that recorded another
                value is not used.

        Raises:
            BusyError: if another process is creating the folder.
            InputError: if the folder is not empty or cannot exist at this path, or the settings contain a NUL; nothing
                is changed.
            StoreError: if the folder cannot be written.
        """
        folder = Path(folder).absolute()
        if "\0" in settings:
            raise InputError("The settings must not contain a NUL.")
        try:
            check_empty(folder, "campaign", "If it holds a campaign, resume that; otherwise choose another folder.")
            make_folder(folder)
        except (FileExistsError, NotADirectoryError) as error:
            raise InputError(f"{folder}: cannot be a run folder: {error.strerror}.") from None
        except OSError as error:
            raise StoreError(f"Cannot create {folder}: {error.strerror or error}.") from error
        store = cls(folder, settings, schema, FolderLock(folder), provenance or {}, decisive)
        try:
            publish(folder / SETTINGS, settings.encode(), store._check_place)
            store._load()
        except BaseException:
            store.close()
            raise
        return store

    @classmethod
    def open(
        cls,
        folder: str | os.PathLike[str],
        schema: Schema | None = None,
        *,
        write: bool,
        provenance: Mapping[str, str] | None = None,
        decisive: Collection[str] = (),
    ) -> Self:
        """The record in a run folder. A writer takes the lock and cleans up after a crash; a reader changes nothing.

        Args:
            folder: the run folder.
            schema: the meaning of the columns; None takes the schema of the batches.
            write: whether to open for writing.
            provenance: current versions and digests; a warning names those that differ from the last batch's.
            decisive: as for `create`; names that `provenance` lacks are not compared.

        Raises:
            BusyError: if another process is writing to the folder.
            InputError: if it is opened for writing and has neither a schema nor a batch.
            StoreError: if it is not a run folder, contains a symbolic link, or cannot be read or written; if its
                settings, schema or version differ; if designs are missing before others, or two files contradict each
                other. No batch is changed.
        """
        folder = Path(folder).absolute()
        path = folder / SETTINGS
        refuse_links(folder)
        try:
            settings = read_regular(path, LARGEST_SETTINGS).decode()
        except FileNotFoundError:
            names = [name for name in plain_files(folder / SEGMENTS) if is_segment(name)]
            hint = f" Restore it: segments/{names[0]} holds its text, in the dataset 'settings'." if names else ""
            raise StoreError(f"{folder} is not a run folder: campaign.toml is missing.{hint}") from None
        except OSError as error:
            raise StoreError(f"Cannot read {path}: {error.strerror or error}.") from error
        except UnicodeDecodeError:
            raise StoreError(
                f"{path} is no longer UTF-8 text. Restore it from the dataset 'settings' of a file in segments/."
            ) from None
        except ValueError as error:
            raise StoreError(
                f"{path} {error}. Restore it from the dataset 'settings' of a file in segments/."
            ) from None
        store = cls(folder, settings, schema, FolderLock(folder) if write else None, provenance or {}, decisive)
        try:
            store._load()
        except BaseException:
            store.close()
            raise
        return store

    def _load(self) -> None:
        """Read and check all batches; only then, and only under the lock, clean up."""
        folder = self.folder / SEGMENTS
        segments, damaged = read_segments(folder)
        check_campaign(segments, self.settings, self.schema)
        if self.schema is None and segments:
            self.schema = segments[0].schema
        if self.schema is None and self._lock:
            raise InputError(f"{self.folder} holds no batch yet: a schema is required for writing.")
        if self.schema:
            self._start = chain_start(self.settings, self.schema)
        try:
            recovery = recover(segments, damaged, self._start)
        except StoreError as error:
            raise StoreError(f"{self.folder}: {error}") from error
        self._segments = list(recovery.chain)
        self._batches = [batch for segment in recovery.chain for batch in segment.batches]
        self._asked = self._read_asked()
        self._corrections = self._read_corrections()
        for name in plain_files(folder):
            if not is_segment(name) and not name.startswith(TEMPORARY) and QUARANTINE not in name:
                self._warn(f"segments/{name} is ignored: its name is not that of a segment.")
        if self._lock:
            self._check_place()
            for text in clear_remains(self.folder, recovery):
                self._warn(text)
            self._compare_provenance()
            self._remove_lost_corrections()
        else:
            for name, reason in sorted(recovery.damaged.items()):
                self._warn(f"segments/{name} {reason}; it is ignored. A writer will rename it to {QUARANTINE}.")

    def _compare_provenance(self) -> None:
        provenance = self._segments[-1].provenance if self._segments else {}
        # A merged segment may hold several values in sequence.
        before = {name: [*compaction.history(text, 0).values()][-1] for name, text in provenance.items()}
        changed = {name: now for name, now in self._provenance.items() if before.get(name, now) != now}
        # An entry named after a settings key is the digest of the user code that the key refers to.
        code = {name: changed.pop(name) for name in list(changed) if "." in name}
        for name, now in code.items():
            self._warn(
                f"Your code has changed since the last batch: {_setting(self.settings, name)} ({name}) or a module "
                f"that it imports, {_short(before[name])} -> {_short(now)}. New simulations use the current code."
            )
        if changed:
            self._warn(
                "This machine or its software differs from that of the last batch, so the continued campaign is not "
                "bit-identical to an uninterrupted one: "
                + "; ".join(f"{name} {_short(before[name])} -> {_short(now)}" for name, now in changed.items())
                + "."
            )

    @property
    def warnings(self) -> tuple[str, ...]:
        """Messages for the user: files quarantined, skipped or ignored, changed versions, missing locks."""
        return tuple(self._warnings)

    def new_warnings(self) -> tuple[str, ...]:
        """The warnings since the last call."""
        shown, self._shown = self._shown, len(self._warnings)
        return tuple(self._warnings[shown:])

    def _warn(self, text: str) -> None:
        text = visible(text)  # it may contain an untrusted file name
        if text not in self._warnings:
            self._warnings.append(text)

    @property
    def batches(self) -> tuple[Batch, ...]:
        """All committed batches, in order, with the corrections."""
        return self._join()[0]

    def _join(self) -> tuple[tuple[Batch, ...], Corrections]:
        """The batches with their corrections, and the corrections that apply to them."""
        if self._joined is None:
            batches, applied = corrected(self._batches, self._corrections)
            self._joined = tuple(batches), self._corrections[applied]
        return self._joined

    @property
    def segments(self) -> tuple[Segment, ...]:
        """The chain of segments that hold the batches, in order, without the corrections."""
        return tuple(self._segments)

    @property
    def _end(self) -> str:
        """The chain's digest after all batches; without batches, that of the settings and the schema."""
        return self._segments[-1].after if self._segments else self._start

    @property
    def digest(self) -> str:
        """A digest of all batches and corrections; without either, of the settings and the schema."""
        return record_digest(self._end, self._join()[1].digest)

    def _writable(self) -> Schema:
        """The schema for writing.

        Raises:
            StoreError: if this object may not write.
        """
        if self._refusal or self.schema is None:
            raise StoreError(self._refusal)
        if os.getpid() != self._pid:
            raise StoreError(
                f"{self.folder} was opened in another process (before a fork); open it again in this process."
            )
        return self.schema

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Guard one change of the folder. If it may be incomplete, this object refuses every later change."""
        self._refusal = (
            f"Writing to {self.folder} was interrupted. Acknowledged data is intact; resume the campaign, or in Python "
            "open the folder again."
        )
        try:
            # Before anything is written; `publish` and `replace` check again before a file gets its name.
            self._check_place()
            yield
        except _MovedError as error:
            self._refusal = str(error)
            raise
        except SyncError as error:
            self._refusal = str(error)
            self._check_place()
            raise
        except StoreError:
            self._refusal = ""
            # Another folder may be the reason.
            self._check_place()
            raise
        self._refusal = ""

    def _check_place(self) -> None:
        """Check that the folder is still the one that this object opened for writing.

        All paths are absolute: after a move they would lead into a folder that someone creates under the old name.

        Raises:
            _MovedError: if it is not; this object then refuses every later change.
            StoreError: if the system cannot tell.
        """
        try:
            if self._lock is None or self._lock.is_in(self.folder):
                return
        except OSError as error:
            raise StoreError(f"Cannot write to {self.folder}: {error.strerror or error}.") from error
        self._refusal = (
            f"{self.folder} was moved, removed or replaced while this process was writing to it: its {LOCK} is not the "
            f"file that this process opened. Nothing more is written. If the folder was moved, resume it at its new "
            "place; its committed batches are intact."
        )
        raise _MovedError(self._refusal)

    def commit(self, batch: Batch) -> None:
        """Append a batch (see Store); merge segments if there are many small ones."""
        schema = self._writable()
        first = self._segments[-1].last + 1 if self._segments else 0
        copy = checked_copy(batch, schema)
        provenance = self._provenance
        if not isinstance(self._asked, StoreError) and len(self._asked):
            provenance = provenance | {ASKED_ENTRY: self._asked.digest_of(len(self._asked))}
        if len(self._corrections):
            provenance = provenance | {CORRECTED_ENTRY: self._corrections.entry(len(self._corrections))}
        segment = Segment(self.settings, schema, first, self._end, (copy,), provenance)
        data = encode_segment(segment)
        with self._writing():
            self._publish(segment, data)
            self._segments.append(segment)
            self._batches.append(copy)
            self._joined = None
        try:
            self.compact()
        except StoreError as error:
            # The batch is durable; small files only cost time.
            self._warn(f"Small segments were not merged: {error}")

    def _publish(self, segment: Segment, data: bytes) -> None:
        """Commit a segment of new designs, protected against a writer that the lock did not stop."""
        path = self.folder / SEGMENTS / segment.name
        if rival := self._rival(segment):
            raise StoreError(
                f"Cannot write {path}: another process has recorded designs under the same ids in {rival}. "
                "Resume the campaign."
            )
        publish(path, data, self._check_place)
        # The link protects one name only. Of two overlapping names, the later writer sees the other one here.
        if rival := self._rival(segment):
            with suppress(StoreError):
                self._warn(set_aside(path, f"was written at the same time as {rival}"))
            raise StoreError(
                f"{path} was set aside: {rival}, written by another process, has the same design ids. "
                "Resume the campaign."
            )

    def _rival(self, segment: Segment) -> str | None:
        """Another file that contains ids of the segment."""
        for name in plain_files(self.folder / SEGMENTS):
            if is_segment(name) and name != segment.name:
                first, last = (int(number) for number in name.removesuffix(".h5").split("-"))
                if first <= segment.last and segment.first <= last:
                    return name
        return None

    def compact(self) -> None:
        """Merge segments that are due (see `activefail.record.compaction`); batches and chain do not change.

        Raises:
            StoreError: if a merged file cannot be written; its inputs remain.
        """
        self._writable()
        folder = self.folder / SEGMENTS
        while run := compaction.due(self._segments):
            merged = compaction.merge(run)
            if merged.after != run[-1].after:
                raise StoreError(f"Batches of {self.folder} changed in memory; open it again.")
            data = encode_segment(merged)
            with self._writing():
                publish(folder / merged.name, data, self._check_place)
                at = self._segments.index(run[0])
                self._segments[at : at + len(run)] = [merged]
                for segment in run:
                    # Another campaign may have files of these names.
                    self._check_place()
                    # A remaining input is harmless; the next writer removes it.
                    with suppress(OSError):
                        os.unlink(folder / segment.name)
                sync_folder(folder)

    def write_state(self, iteration: int, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Keep named arrays (see Store)."""
        self._writable()
        data = encode_state(iteration, checked_state(iteration, arrays), *self._known_after(iteration))
        with self._writing():
            replace(state_file(self.folder, iteration), data, self._check_place)
            self._rejected.discard(iteration)
            older = [path for i, path in self._states() if i < iteration]
            for path in older[: 1 - STATES_KEPT] + [path for i, path in self._states() if i > iteration]:
                self._check_place()
                with suppress(OSError):
                    os.unlink(path)

    def write_text(self, name: str, text: str) -> None:
        """Write a file beside the record, which can be made again from it."""
        self._writable()
        with self._writing():
            replace(self.folder / name, text.encode(), self._check_place)

    def _states(self) -> list[tuple[int, Path]]:
        """The state files, oldest first."""
        folder = self.folder / STATES
        names = [name for name in plain_files(folder) if re.fullmatch(r"\d{9,}\.h5", name)]
        return sorted((int(name.removesuffix(".h5")), folder / name) for name in names)

    def _known_after(self, iteration: int) -> tuple[str, str]:
        """The chain's digest after the last batch of the iterations up to this one, and that of their corrections."""
        digest, simulations = self._start, 0
        for segment in self._segments:
            if segment.batches[0].iteration > iteration:
                break
            ends = itertools.accumulate(map(len, segment.batches), initial=segment.first)
            for batch, end in zip(segment.batches, itertools.islice(ends, 1, None), strict=True):
                if batch.iteration <= iteration:
                    digest, simulations = segment.chain[end], end
        return digest, self._join()[1].before(simulations).digest

    def latest_state(self) -> tuple[int, dict[str, NDArray[Any]]] | None:
        """The newest intact state of this record (see Store)."""
        digests = {digest for segment in self._segments for digest in segment.chain.values()} or {self._start}
        for iteration, path in reversed(self._states()):
            if iteration in self._rejected:
                continue
            try:
                with reading(path):
                    known, arrays = decode_state(path.read_bytes(), iteration, digests)
                # A state of this record that lacks a later batch of its iteration, or a correction, is no fault.
                if known == self._known_after(iteration):
                    return iteration, arrays
            except FileNotFoundError:
                continue
            except DamagedError as error:
                self._warn(f"state/{path.name} {error}; it is skipped.")
        return None

    def reject_state(self, iteration: int, reason: str) -> None:
        """Skip a state from now on (see Store)."""
        self._rejected.add(iteration)
        self._warn(f"state/{iteration:09d}.h5 {reason}; it is skipped.")

    @property
    def asked(self) -> Asked:
        """The designs that were handed out, as of opening (see Store)."""
        if isinstance(self._asked, StoreError):
            raise self._asked
        return self._asked.copy()

    def _read_asked(self) -> "Asked | StoreError":
        """The designs that were handed out; the error if they cannot be read, for those who ask for them."""
        path = self.folder / ASKED
        columns = 0 if self.schema is None else len(self.schema.variables)
        try:
            with reading(path):
                data = read_regular(path, LARGEST_ASKED)
            if self.schema is None:
                return StoreError(f"{path} cannot be read without a schema while the record holds no batch.")
            asked, noted = decode_asked(data, self._start, columns)
        except FileNotFoundError:
            asked, noted = Asked.none(columns), ""
        except (DamagedError, ValueError) as error:
            return StoreError(
                f"{path} {error}. It lists the designs in flight. Restore it from a copy; if you remove it, designs in "
                "flight may be handed out again."
            )
        except StoreError as error:
            return error
        if not continues(self._known(ASKED_ENTRY), asked.digest_of):
            return StoreError(
                f"{path} does not match the last batch: it was removed, or replaced by an older or a different list. "
                "Restore it from a copy; without it, designs in flight would be handed out again."
            )
        self._noted = noted
        return asked

    def _known(self, entry: str) -> str:
        """What the last batch noted of a list; empty if there was none."""
        return self._segments[-1].provenance.get(entry, "") if self._segments else ""

    def write_asked(self, asked: Asked) -> None:
        """Keep the designs that were handed out (see Store)."""
        self._write_asked(asked, self._corrections)

    def _write_asked(self, asked: Asked, corrections: Corrections) -> None:
        schema = self._writable()
        check_asked(asked, schema)
        noted = corrections.entry(len(corrections)) if len(corrections) else ""
        data = encode_asked(asked, self._start, noted)
        with self._writing():
            replace(self.folder / ASKED, data, self._check_place)
            self._asked, self._noted = asked.copy(), noted

    @property
    def corrections(self) -> Corrections:
        """The corrections of the batches, in the order in which they were made (see Store)."""
        return self._join()[1].copy()

    def _read_corrections(self) -> Corrections:
        """All corrections in the file.

        Raises:
            StoreError: if they cannot be read: without them, wrong results would be learned from.
        """
        path = self.folder / CORRECTIONS
        corrections = Corrections.none(self.schema)
        if self.schema is None:
            return corrections
        try:
            with reading(path):
                data = read_regular(path, LARGEST_CORRECTIONS)
            corrections = decode_corrections(data, self._start, self.schema)
        except FileNotFoundError:
            pass
        except (DamagedError, ValueError) as error:
            raise StoreError(f"{path} {error}. It lists corrected results. Restore it from a copy.") from None
        for known, what in ((self._known(CORRECTED_ENTRY), "the last batch"), (self._noted, ASKED)):
            if not continues(known, corrections.entry):
                raise StoreError(
                    f"{path} does not match {what}: it was removed, or replaced by an older or a different list. "
                    "Restore it from a copy; without it, results that were corrected would be wrong again."
                )
        return corrections

    def _remove_lost_corrections(self) -> None:
        """Remove corrections of batches that were lost: they must not apply to what will be recorded at their places.

        The former file stays, under another name.
        """
        kept = self._join()[1]
        if len(kept) == len(self._corrections):
            return
        schema, path = self._writable(), self.folder / CORRECTIONS
        aside = quarantine_of(path)
        is_noted = bool(self._noted)
        if is_noted:
            # An interruption must not leave a note of corrections that are gone.
            self._write_asked(self.asked, Corrections.none(schema))
        with self._writing():
            publish(aside, encode_corrections(self._corrections, schema, self._start), self._check_place)
            replace(path, encode_corrections(kept, schema, self._start), self._check_place)
        lost = len(self._corrections) - len(kept)
        self._corrections = kept
        if is_noted:
            self._write_asked(self.asked, kept)
        self._warn(
            f"{CORRECTIONS}: {lost} of the corrections were removed, because the results that they replaced were lost. "
            f"{aside.name} is the former file."
        )

    def correct(self, place: NDArray[np.int64], results: Results) -> None:
        """Replace results of the batches (see Store)."""
        schema, asked = self._writable(), self.asked
        corrections = self._corrections.and_then(correcting(self.batches, place, results, schema))
        data = encode_corrections(corrections, schema, self._start)
        with self._writing():
            replace(self.folder / CORRECTIONS, data, self._check_place)
            self._corrections, self._joined = corrections, None
        # Each of the two lists then shows that the other one is missing or older.
        self._write_asked(asked, corrections)

    def write_set(self, name: str, X: Array, results: Results) -> None:
        """Keep a set (see Store)."""
        schema = self._writable()
        check_set(name, X, results, schema)
        data = encode_set(X, results, schema, self._start, self._provenance)
        with self._writing():
            replace(set_file(self.folder, name), data, self._check_place)

    def read_set(self, name: str) -> tuple[Array, Results] | None:
        """The set, or None (see Store); a damaged or foreign set is quarantined."""
        path = set_file(self.folder, name)
        if path.name not in plain_files(path.parent):
            return None
        try:
            with reading(path):
                X, results, provenance = decode_set(path.read_bytes(), self.settings)
        except DamagedError as error:
            if self._refusal:
                self._warn(f"sets/{path.name} {error}; it is ignored.")
            else:
                # A folder of this name may belong to another campaign.
                self._check_place()
                self._warn(set_aside(path, str(error)))
            return None
        changed = [
            f"{entry} {_short(provenance[entry])} -> {_short(self._provenance[entry])}"
            for entry in sorted(self._decisive & self._provenance.keys() & provenance.keys())
            if provenance[entry] != self._provenance[entry]
        ]
        if changed:
            again = "" if self._refusal else " Its designs are simulated again when they are needed."
            self._warn(
                f"sets/{path.name} was simulated with different code ({'; '.join(changed)}); it is not used.{again}"
            )
            return None
        return X, results

    def set_names(self) -> list[str]:
        """Names of the sets (see Store)."""
        names = plain_files(self.folder / SETS)
        return [name.removesuffix(".h5") for name in names if name.endswith(".h5") and not name.startswith(TEMPORARY)]

    def close(self) -> None:
        """Refuse further writes and release the lock; the batches stay readable."""
        if self._lock:
            self._lock.release()
            self._lock = None
            self._refusal = f"This store of {self.folder} is closed."

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()
