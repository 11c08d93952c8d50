"""The record of a campaign in its run folder: batches in a chain of immutable files, and what is kept beside them.

    <folder>/campaign.toml              frozen copy of the settings
             segments/<first>-<last>.h5 whole batches: the truth, from which the rest can be rebuilt; immutable
             state/<iteration>.h5       what was learned; the last three
             sets/<name>.h5             designs beside the campaign and their results, simulated once
             .lock                      one writer at a time

Every batch extends a chain of digests that begins with the settings and the schema. So a segment that is missing,
altered or from another campaign is noticed. Merging segments leaves the chain as it is.
"""

import os
import re
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Self

from numpy.typing import NDArray

from activefail import __version__
from activefail.errors import DamagedError, InputError, StoreError, SyncError
from activefail.files import TEMPORARY, make_folder, publish, read_regular, replace, sync_folder
from activefail.record import compaction
from activefail.record.attachments import decode_set, decode_state, encode_set, encode_state
from activefail.record.batch import Batch, Schema, own_copy
from activefail.record.layout import FOLDERS, LARGEST_SETTINGS, LOCK, SETTINGS, refuse_links
from activefail.record.lock import FolderLock
from activefail.record.recovery import (
    QUARANTINE,
    Recovery,
    check_campaign,
    is_segment,
    plain_files,
    read_segments,
    reading,
    recover,
    set_aside,
)
from activefail.record.segment import Segment, chain_start, encode_segment
from activefail.record.store import STATES_KEPT, check_set, checked_state
from activefail.simulators.interface import Results
from activefail.space import Array
from activefail.visible import visible


def _named(settings: str, key: str) -> str:
    """The value of a key like "simulator.python" in the text of settings."""
    value: Any = tomllib.loads(settings)
    for part in key.split("."):
        value = value[part]
    return str(value)


def _short(entry: str) -> str:
    """An entry of the provenance, of a digest its beginning."""
    return entry[:8] if re.fullmatch("[0-9a-f]{64}", entry) else entry


def check_empty(folder: Path, what: str, instead: str) -> None:
    """Check that a folder is empty or missing. What an interrupted creation leaves does not count.

    Args:
        folder: for something new.
        what: it is for.
        instead: advice if it holds anything.

    Raises:
        InputError: if it holds anything else.
        OSError: if it cannot be read.
    """
    present = sorted(os.listdir(folder)) if folder.exists() else []
    found = [name for name in present if name != LOCK and not name.startswith(TEMPORARY)]
    if found:
        raise InputError(
            f"{folder} is not empty (it holds {visible(found[0])}): a new {what} needs a new folder. {instead}"
        )


class FolderStore:
    """A record in a run folder, made by `create` or `open`; keeps the promises of `Store`.

    Attributes:
        folder: where it is.
        settings: the text of campaign.toml.
        schema: what its columns mean; None in a record without batches that was opened for reading without a schema.
    """

    def __init__(
        self, folder: Path, settings: str, schema: Schema | None, lock: FolderLock | None, provenance: Mapping[str, str]
    ) -> None:
        self.folder = folder
        self.settings = settings
        self.schema = schema
        self._provenance = {"activefail": __version__, **provenance}
        self._lock = lock
        self._warnings: list[str] = []
        self._shown = 0
        self._rejected: set[int] = set()
        self._segments: list[Segment] = []
        self._start = ""
        self._batches: list[Batch] = []
        # Made when asked for: a commit must not copy all that was committed before.
        self._batches_read: tuple[Batch, ...] | None = None
        # Why this object may not write; empty if it may.
        self._refusal = "" if lock else f"{folder} was opened for reading only."
        if lock and not lock.held:
            self._warn(f"The file system of {folder} has no locks: make sure that one process at a time writes there.")

    @classmethod
    def create(
        cls,
        folder: str | os.PathLike[str],
        settings: str,
        schema: Schema,
        *,
        provenance: Mapping[str, str] | None = None,
    ) -> Self:
        """A new run folder with the frozen settings, open for writing.

        A creation that was interrupted before it wrote campaign.toml can be repeated.

        Args:
            folder: missing or empty.
            settings: the text of campaign.toml.
            schema: what the columns mean.
            provenance: versions and digests that are recorded with every batch, by name.

        Raises:
            BusyError: if another process is creating it.
            InputError: if the folder is not empty, no folder can be there, or the settings hold a NUL; nothing was
                changed.
            StoreError: if the folder cannot be written.
        """
        folder = Path(folder).absolute()
        if "\0" in settings:
            raise InputError("The settings must not hold a NUL.")
        try:
            check_empty(folder, "campaign", "Resume the campaign in it, if there is one, or choose another folder.")
            make_folder(folder)
        except (FileExistsError, NotADirectoryError) as error:
            raise InputError(f"{folder}: cannot be a run folder: {error.strerror}.") from None
        except OSError as error:
            raise StoreError(f"Cannot create {folder}: {error.strerror or error}.") from error
        store = cls(folder, settings, schema, FolderLock(folder), provenance or {})
        try:
            publish(folder / SETTINGS, settings.encode())
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
    ) -> Self:
        """The record in a run folder. To write, it takes the lock and tidies up after a crash; else nothing changes.

        Args:
            folder: of the run.
            schema: what the columns mean; that of the batches if None.
            write: whether batches, states and sets are to be written.
            provenance: versions and digests of now; a warning says which differ from those of the last batch.

        Raises:
            BusyError: if another process is writing to the folder.
            InputError: if it is opened to write and neither a schema nor a batch says what the columns mean.
            StoreError: if it is not a run folder, holds a symbolic link, or cannot be read or written; if its settings
                were changed, or its schema or version is another one; if designs are missing before others, or two
                files contradict each other. No batch was changed.
        """
        folder = Path(folder).absolute()
        path = folder / SETTINGS
        refuse_links(folder)
        try:
            settings = read_regular(path, LARGEST_SETTINGS).decode()
        except FileNotFoundError:
            kept = [name for name in plain_files(folder / "segments") if is_segment(name)]
            hint = f" Restore it: segments/{kept[0]} holds its text, in the dataset 'settings'." if kept else ""
            raise StoreError(f"{folder} is not a run folder: campaign.toml is missing.{hint}") from None
        except OSError as error:
            raise StoreError(f"Cannot read {path}: {error.strerror or error}.") from error
        except UnicodeDecodeError:
            raise StoreError(f"{path} is not UTF-8 text any more. Restore the frozen copy.") from None
        except ValueError as error:
            raise StoreError(f"{path} {error}. Restore the frozen copy.") from None
        store = cls(folder, settings, schema, FolderLock(folder) if write else None, provenance or {})
        try:
            store._load()
        except BaseException:
            store.close()
            raise
        return store

    def _load(self) -> None:
        """Read and check all batches; only then, and only under the lock, tidy up."""
        folder = self.folder / "segments"
        segments, damaged = read_segments(folder)
        check_campaign(segments, self.settings, self.schema)
        if self.schema is None and segments:
            self.schema = segments[0].schema
        if self.schema is None and self._lock:
            raise InputError(f"{self.folder} holds no batch yet: to write to it, say what the columns mean (schema).")
        if self.schema:
            self._start = chain_start(self.settings, self.schema)
        try:
            recovery = recover(segments, damaged, self._start)
        except StoreError as error:
            raise StoreError(f"{self.folder}: {error}") from error
        self._segments = list(recovery.chain)
        self._batches = [batch for segment in recovery.chain for batch in segment.batches]
        for name in plain_files(folder):
            if not is_segment(name) and not name.startswith(TEMPORARY) and QUARANTINE not in name:
                self._warn(f"segments/{name} is not a segment's name; the file is ignored.")
        if self._lock:
            self._tidy(recovery)
            self._compare_provenance()
        else:
            for name, reason in sorted(recovery.damaged.items()):
                self._warn(f"segments/{name} {reason}; it is ignored. Opening to write renames it to {QUARANTINE}.")

    def _compare_provenance(self) -> None:
        provenance = self._segments[-1].provenance if self._segments else {}
        # A merged segment may hold several, one after the other.
        before = {name: [*compaction.history(text, 0).values()][-1] for name, text in provenance.items()}
        changed = {name: now for name, now in self._provenance.items() if before.get(name, now) != now}
        # An entry that is named after a key of the settings is the digest of the user's code that the key names.
        code = {name: changed.pop(name) for name in list(changed) if "." in name}
        for name, now in code.items():
            self._warn(
                f"Your own code has changed since the last batch, {_named(self.settings, name)} ({name}) or what it "
                f"imports: {_short(before[name])} -> {_short(now)}. What follows is by the code as it is now."
            )
        if changed:
            self._warn(
                "This machine or its versions are not those of the last batch, so that what follows is not "
                "bit-identical to an uninterrupted campaign: "
                + "; ".join(f"{name} {_short(before[name])} -> {_short(now)}" for name, now in changed.items())
                + "."
            )

    def _tidy(self, recovery: Recovery) -> None:
        """Make the folders, set bad files aside, remove temporaries and what a compaction left. Data stays."""
        folder = self.folder / "segments"
        try:
            for name in FOLDERS:
                with suppress(FileExistsError):
                    os.mkdir(self.folder / name)
            for place in (self.folder, *(self.folder / name for name in FOLDERS)):
                for name in plain_files(place):
                    if name.startswith(TEMPORARY):
                        os.unlink(place / name)
            for name, reason in sorted(recovery.damaged.items()):
                self._warn(set_aside(folder / name, reason))
            # The merged segment must be durable under its name before its inputs go.
            sync_folder(folder)
            for name in recovery.covered:
                os.unlink(folder / name)
        except OSError as error:
            raise StoreError(f"Cannot write to {self.folder}: {error.strerror or error}.") from error
        sync_folder(folder)
        sync_folder(self.folder)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know: files set aside, skipped or ignored, versions that changed, missing locks."""
        return tuple(self._warnings)

    def new_warnings(self) -> tuple[str, ...]:
        """The warnings that came since this was asked last."""
        shown, self._shown = self._shown, len(self._warnings)
        return tuple(self._warnings[shown:])

    def _warn(self, text: str) -> None:
        text = visible(text)  # it may name a stranger's file
        if text not in self._warnings:
            self._warnings.append(text)

    @property
    def batches(self) -> tuple[Batch, ...]:
        """All committed batches, in order."""
        if self._batches_read is None:
            self._batches_read = tuple(self._batches)
        return self._batches_read

    @property
    def _digest(self) -> str:
        """The chain's digest after all batches."""
        return self._segments[-1].after if self._segments else self._start

    def _writable(self) -> Schema:
        """The schema to write by.

        Raises:
            StoreError: if this object may not write.
        """
        if self._refusal or self.schema is None:
            raise StoreError(self._refusal)
        return self.schema

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """One change of the folder. After what may have left it half done, this object refuses any other."""
        self._refusal = f"Writing to {self.folder} was interrupted. Open it again: what was acknowledged is whole."
        try:
            yield
        except SyncError as error:
            self._refusal = str(error)
            raise
        except StoreError:
            self._refusal = ""
            raise
        self._refusal = ""

    def commit(self, batch: Batch) -> None:
        """Append a batch (see Store); merge segments if there are many small ones."""
        schema = self._writable()
        first = self._segments[-1].last + 1 if self._segments else 0
        kept = own_copy(batch, schema)
        segment = Segment(self.settings, schema, first, self._digest, (kept,), self._provenance)
        data = encode_segment(segment)
        with self._writing():
            self._publish(segment, data)
            self._segments.append(segment)
            self._batches.append(kept)
            self._batches_read = None
        try:
            self.compact()
        except StoreError as error:
            # The batch is durable, and so many small files are only slow.
            self._warn(f"Small segments were not merged: {error}")

    def _publish(self, segment: Segment, data: bytes) -> None:
        """Commit a segment of new designs, fenced against a writer that the lock did not stop."""
        path = self.folder / "segments" / segment.name
        taken = f"another writer got there first. Open {self.folder} again."
        if rival := self._rival(segment):
            raise StoreError(f"Cannot write {path}: {rival} holds its designs already; {taken}")
        publish(path, data)
        # The link fences one name only. Of two overlapping names, whoever linked last sees the other one here.
        if rival := self._rival(segment):
            with suppress(StoreError):
                self._warn(set_aside(path, f"was written at the same time as {rival}"))
            raise StoreError(f"Withdrew {path}: {rival} holds its designs already; {taken}")

    def _rival(self, segment: Segment) -> str | None:
        """A file, other than the segment's own, with ids of the segment."""
        for name in plain_files(self.folder / "segments"):
            if is_segment(name) and name != segment.name:
                first, last = (int(number) for number in name.removesuffix(".h5").split("-"))
                if first <= segment.last and segment.first <= last:
                    return name
        return None

    def compact(self) -> None:
        """Merge what is due (see `activefail.record.compaction`); batches and chain stay as they are.

        Raises:
            StoreError: if a merged file cannot be written; its inputs are still there.
        """
        self._writable()
        folder = self.folder / "segments"
        while run := compaction.due(self._segments):
            merged = compaction.merge(run)
            if merged.after != run[-1].after:
                raise StoreError(f"Batches of {self.folder} changed in memory; open it again.")
            data = encode_segment(merged)
            with self._writing():
                publish(folder / merged.name, data)
                at = self._segments.index(run[0])
                self._segments[at : at + len(run)] = [merged]
                for segment in run:
                    # One that stays is harmless, and removed when the folder is opened next.
                    with suppress(OSError):
                        os.unlink(folder / segment.name)
                sync_folder(folder)

    def write_state(self, iteration: int, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Keep named arrays (see Store)."""
        self._writable()
        data = encode_state(iteration, checked_state(iteration, arrays), self._digest)
        with self._writing():
            replace(self.folder / "state" / f"{iteration:09d}.h5", data)
            self._rejected.discard(iteration)
            older = [path for i, path in self._states() if i < iteration]
            for path in older[: 1 - STATES_KEPT] + [path for i, path in self._states() if i > iteration]:
                with suppress(OSError):
                    os.unlink(path)

    def _states(self) -> list[tuple[int, Path]]:
        """The state files, oldest first."""
        folder = self.folder / "state"
        names = [name for name in plain_files(folder) if re.fullmatch(r"\d{9,}\.h5", name)]
        return sorted((int(name.removesuffix(".h5")), folder / name) for name in names)

    def latest_state(self) -> tuple[int, dict[str, NDArray[Any]]] | None:
        """The newest state that is whole and of this record (see Store)."""
        digests = {digest for segment in self._segments for digest in segment.chain.values()} or {self._start}
        for iteration, path in reversed(self._states()):
            if iteration in self._rejected:
                continue
            try:
                with reading(path):
                    return iteration, decode_state(path.read_bytes(), iteration, digests)
            except FileNotFoundError:
                continue
            except DamagedError as error:
                self._warn(f"state/{path.name} {error}; it is skipped.")
        return None

    def reject_state(self, iteration: int, reason: str) -> None:
        """Skip a state from now on (see Store)."""
        self._rejected.add(iteration)
        self._warn(f"state/{iteration:09d}.h5 {reason}; it is skipped.")

    def write_set(self, name: str, X: Array, results: Results) -> None:
        """Keep a set (see Store)."""
        schema = self._writable()
        check_set(name, X, results, schema)
        data = encode_set(X, results, schema, self._start)
        with self._writing():
            replace(self.folder / "sets" / f"{name}.h5", data)

    def read_set(self, name: str) -> tuple[Array, Results] | None:
        """The set, or None (see Store); one that is damaged or of another campaign is set aside."""
        path = self.folder / "sets" / f"{name}.h5"
        if path.name not in plain_files(path.parent):
            return None
        try:
            with reading(path):
                return decode_set(path.read_bytes(), self.settings)
        except DamagedError as error:
            if self._refusal:
                self._warn(f"sets/{path.name} {error}; it is ignored.")
            else:
                self._warn(set_aside(path, str(error)))
        return None

    def set_names(self) -> list[str]:
        """Names of the sets (see Store)."""
        names = plain_files(self.folder / "sets")
        return [name.removesuffix(".h5") for name in names if name.endswith(".h5") and not name.startswith(TEMPORARY)]

    def close(self) -> None:
        """Write nothing more and release the lock; the batches stay readable."""
        if self._lock:
            self._lock.release()
            self._lock = None
            self._refusal = f"This store of {self.folder} is closed."

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()
