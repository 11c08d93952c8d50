"""The record of a campaign in its run folder: a journal of events, and a checkpoint that can be made again.

    <folder>/campaign.toml   frozen copy of the settings
             journal         all that happened, in order: batches, designs that were handed out, corrections, sets, ...
             checkpoint.h5   the simulations as columns, and the last states of the classifier

The checkpoint is written with each state. The columns are added when a writer closes the record: with every state, they
would be written thousands of times.
"""

import difflib
import os
import re
import tomllib
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, Self

from activefail.errors import InputError, StoreError, SyncError
from activefail.record.batch import Schema
from activefail.record.checkpoint import LARGEST_CHECKPOINT, States, decode, encode, load_hdf5
from activefail.record.events import Event
from activefail.record.journal import Journal
from activefail.record.layout import CHECKPOINT, JOURNAL, LARGEST_SETTINGS, RESERVED, SETTINGS, refuse_format_1
from activefail.record.memory import MemoryStore
from activefail.record.store import check_asked
from activefail.simulators.interface import Results
from activefail.space.space import Array
from activefail.text.files import is_temporary, make_folder, replace
from activefail.text.trust import read_regular, refuse_links
from activefail.version import __version__
from activefail.visible import visible


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
    foreign = [name for name in entries if name != JOURNAL and not is_temporary(name)]
    if foreign:
        raise InputError(
            f"{folder} is not empty (it holds {visible(foreign[0])}): a new {what} needs a new folder. {instead}"
        )


class FolderStore(MemoryStore):
    """A record in a run folder, from `create` or `open`; implements `Store`.

    Attributes:
        folder: the run folder.
        settings: the text of campaign.toml.
    """

    def __init__(
        self, folder: Path, journal: Journal, provenance: Mapping[str, str] | None, decisive: Collection[str]
    ) -> None:
        self._start()
        self.folder = folder
        self._journal = journal
        self._provenance = {"activefail": __version__, **(provenance or {})}
        self._decisive = frozenset(decisive)
        # A fork inherits the lock, and would be a second writer.
        self._pid = os.getpid()
        self._warnings: list[str] = []
        self._shown = 0
        self._is_changed = self._has_read_states = False
        self._refusal = f"{folder} was opened for reading only."

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
            provenance: versions and digests to record with batches and sets, by name.
            decisive: names in `provenance` of what decides the results of a simulation. A set that recorded another
                value is not used.

        Raises:
            BusyError: if another process is creating the folder.
            InputError: if the folder is not empty or cannot exist at this path, or the settings are too long; nothing
                is changed.
            StoreError: if the folder cannot be written.
        """
        folder = Path(folder).absolute()
        if (size := len(settings.encode())) > LARGEST_SETTINGS:
            raise InputError(f"{folder}: {SETTINGS} must have at most {LARGEST_SETTINGS} bytes, would have {size}.")
        try:
            check_empty(folder, "campaign", "If it holds a campaign, resume that; otherwise choose another folder.")
            make_folder(folder)
        except (FileExistsError, NotADirectoryError) as error:
            raise InputError(f"{folder}: cannot be a run folder: {error.strerror}.") from None
        except OSError as error:
            raise StoreError(f"Cannot create {folder}: {error.strerror or error}.") from error
        store = cls(folder, Journal(folder, write=True, create=True), provenance, decisive)
        with store._closing_on_error():
            # Whoever had the lock may have created a campaign.
            if os.path.lexists(folder / SETTINGS):
                raise InputError(f"{folder} is not empty: it holds a campaign. Choose another folder.")
            store._journal.begin(Event("campaign", {"settings": settings, "schema": asdict(schema)}, {}))
            replace(folder / SETTINGS, settings.encode(), store._check_place)
            store._load(settings, schema)
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
            schema: the meaning of the columns, which must be that of the record; None for any.
            write: whether to open for writing.
            provenance: current versions and digests; a warning names those that differ from the last ones recorded.
            decisive: as for `create`; names that `provenance` lacks are not compared.

        Raises:
            BusyError: if another process is writing to the folder.
            StoreError: if it is not a run folder, contains a symbolic link, or cannot be read or written; if its
                settings, schema or version differ, or the journal is damaged before its end. Nothing is changed.
        """
        folder = Path(folder).absolute()
        refuse_links(folder, RESERVED)
        refuse_format_1(folder)
        settings = _settings_of(folder)
        store = cls(folder, Journal(folder, write), provenance, decisive)
        with store._closing_on_error():
            store._load(settings, schema)
            if write:
                store._clean_up()
        return store

    @contextmanager
    def _closing_on_error(self) -> Iterator[None]:
        try:
            yield
        except BaseException:
            self._journal.close()
            raise

    def _load(self, settings: str, schema: Schema | None) -> None:
        """Replay the journal, and compare it with the settings and the schema."""
        path = self._journal.path
        try:
            for entry in self._journal.entries():
                self._take(entry.event, entry.content)
            check_asked(self._handed_out, self.schema, self._iteration)
        except StoreError:
            raise
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            reason = visible(str(error))
            raise StoreError(f"{path} has content that activefail never writes ({reason}). Restore a copy.") from None
        if settings != self.settings:
            pair = self.settings.splitlines(), settings.splitlines()
            changes = map(visible, difflib.unified_diff(*pair, f"in {JOURNAL}", SETTINGS, lineterm=""))
            raise StoreError(
                f"The settings were changed after the campaign began: {SETTINGS} differs from those in {JOURNAL}. "
                "Restore the frozen copy, or start a new campaign in another folder. Changes:\n"
                + ("\n".join(changes) or "only line endings")
            )
        if schema not in (None, self.schema):
            raise StoreError(f"The schema is not that of the campaign: {path} holds {self.schema}, not {schema}.")
        if self._journal.is_writer:
            self._refusal = ""
            load_hdf5()
            self._remove_temporaries()
            if not self._journal.has_lock:
                self._warn(f"The file system of {self.folder} has no locks: make sure that only one process writes.")
        elif self._journal.damage:
            self._warn(f"{self._journal.damage}; it is ignored. A writer will set it aside.")

    def _remove_temporaries(self) -> None:
        self._check_place()
        try:
            for name in os.listdir(self.folder):
                if is_temporary(name):
                    os.unlink(self.folder / name)
        except OSError as error:
            raise StoreError(f"Cannot write to {self.folder}: {error.strerror or error}.") from error

    def _clean_up(self) -> None:
        """Set aside what a crash left of an entry, and say what has changed since the last batch."""
        if text := self._journal.set_aside():
            self._warn(text)
        changed = _changed(self._made_by, self._provenance)
        # An entry named after a settings key is the digest of the user code that the key refers to.
        for name in [name for name in changed if "." in name]:
            self._warn(
                f"Your code has changed since the last batch: {_setting(self.settings, name)} ({name}) or a file "
                f"that it uses, {changed.pop(name)}. New simulations use the current code."
            )
        if changed:
            self._warn(
                "This machine or its software differs from that of the last batch, so the continued campaign is not "
                f"bit-identical to an uninterrupted one: {'; '.join(f'{one} {how}' for one, how in changed.items())}."
            )

    @property
    def warnings(self) -> tuple[str, ...]:
        """Messages for the user: entries and states left out, changed versions, missing locks."""
        return tuple(self._warnings)

    def new_warnings(self) -> tuple[str, ...]:
        """The warnings since the last call."""
        shown, self._shown = self._shown, len(self._warnings)
        return tuple(self._warnings[shown:])

    def _warn(self, text: str) -> None:
        text = visible(text)  # it may contain an untrusted name
        if text not in self._warnings:
            self._warnings.append(text)

    def _writable(self) -> Schema:
        if os.getpid() != self._pid:
            raise StoreError(f"{self.folder} was opened before a fork; open it again in this process.")
        return super()._writable()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Guard one change of the folder. If it may be incomplete, this object refuses every later change."""
        self._writable()
        self._refusal = (
            f"Writing to {self.folder} was interrupted. Acknowledged data is intact; resume the campaign, or in Python "
            "open the folder again."
        )
        try:
            self._check_place()
            yield
        except SyncError as error:
            self._refusal = str(error)
            raise
        except StoreError:
            self._refusal = ""
            raise
        self._refusal, self._is_changed = "", True

    def _check_place(self) -> None:
        """Check that the folder is still the one that this object opened for writing.

        All paths are absolute: after a move they would lead into a folder that someone creates under the old name.

        Raises:
            StoreError: if it is not, or the system cannot tell.
        """
        try:
            is_there = self._journal.is_in(self.folder)
        except OSError as error:
            raise StoreError(f"Cannot write to {self.folder}: {error.strerror or error}.") from error
        if not is_there:
            raise StoreError(
                f"{self.folder} was moved, removed or replaced while this process was writing to it: its {JOURNAL} is "
                "not the file that this process opened. Nothing more is written. If the folder was moved, resume it at "
                "its new place; its committed batches are intact."
            )

    def _record(self, *events: Event) -> None:
        if not events:
            return
        if self._made_by != self._provenance:
            events = (Event("software", self._provenance, {}), *events)
        with self._writing():
            for event, content in zip(events, self._journal.append(events), strict=True):
                self._take(event, content)

    def _save_states(self, states: States, with_columns: bool = False) -> None:
        data = encode(states, self.schema, self.batches if with_columns else ())
        with self._writing():
            replace(self.folder / CHECKPOINT, data, self._check_place)
        self._states, self._has_read_states = states, True

    def _saved_states(self) -> States:
        """The states in the checkpoint; none if it is missing or damaged."""
        if self._has_read_states:
            return self._states
        path = self.folder / CHECKPOINT
        try:
            self._states = decode(read_regular(path, LARGEST_CHECKPOINT))
        except FileNotFoundError:
            self._states = {}
        except OSError as error:
            raise StoreError(f"Cannot read {path}: {error.strerror or error}.") from error
        except (StoreError, ValueError) as error:
            self._states = {}
            self._warn(f"{CHECKPOINT} {error}; what it held is learned again.")
        # Only a writer knows of every change.
        self._has_read_states = self._journal.is_writer
        return self._states

    def reject_state(self, iteration: int, reason: str) -> None:
        """Skip a state from now on (see Store)."""
        super().reject_state(iteration, reason)
        self._warn(f"{CHECKPOINT}: the state of iteration {iteration} {reason}; it is skipped.")

    def read_set(self, name: str) -> tuple[Array, Results] | None:
        """The set, or None (see Store)."""
        made_by = self._sets[name][2] if name in self._sets else {}
        here = {entry: text for entry, text in self._provenance.items() if entry in self._decisive}
        if changed := _changed({entry: made_by[entry] for entry in sorted(made_by)}, here):
            again = "" if self._refusal else " Its designs are simulated again when they are needed."
            how = "; ".join(f"{entry} {change}" for entry, change in changed.items())
            self._warn(f"The set {name} was simulated with different code ({how}); it is not used.{again}")
            return None
        return super().read_set(name)

    def close(self) -> None:
        """Add the columns to the checkpoint, refuse further writes and release the lock; the record stays readable."""
        if not self._journal.is_writer:
            return
        try:
            if self.batches and not self._refusal and (self._is_changed or not (self.folder / CHECKPOINT).exists()):
                self._save_states(self._saved_states(), with_columns=True)
        except StoreError as error:
            self._warn(f"{CHECKPOINT} was not written, and will be made again: {error}")
        finally:
            self._journal.close()
            self._refusal = self._refusal or f"This store of {self.folder} is closed."


def _settings_of(folder: Path) -> str:
    """The text of the frozen settings."""
    path, restore = folder / SETTINGS, ""
    if os.path.exists(folder / JOURNAL):
        restore = " Restore it from a copy, or from the first entry of the journal."
    try:
        return read_regular(path, LARGEST_SETTINGS).decode()
    except FileNotFoundError:
        raise StoreError(f"{folder} is not a run folder: {SETTINGS} is missing.{restore}") from None
    except OSError as error:
        raise StoreError(f"Cannot read {path}: {error.strerror or error}.") from error
    except UnicodeDecodeError:
        raise StoreError(f"{path} is no longer UTF-8 text.{restore}") from None
    except ValueError as error:
        raise StoreError(f"{path} {error}.{restore}") from None


def _changed(before: Mapping[str, str], now: Mapping[str, str]) -> dict[str, str]:
    """How the entries of a provenance have changed, by name; digests are abbreviated."""
    short = {
        text: text[:8] if re.fullmatch("[0-9a-f]{64}", text) else text for text in (*before.values(), *now.values())
    }
    return {
        name: f"{short[before[name]]} -> {short[text]}" for name, text in now.items() if before.get(name, text) != text
    }


def _setting(settings: str, key: str) -> str:
    """The value of a key such as "simulator.python" in the text of the settings."""
    value: Any = tomllib.loads(settings)
    for part in key.split("."):
        value = value[part]
    return str(value)
