"""The folders of custom code that a user has already run a campaign with, on this machine.

A run folder may come from someone else, so activefail runs the code that it names only if the user names the folder of
that code. To name it once is enough: activefail notes it outside the run folder, in a private file of the user, and
uses it again while everything that the user agreed to is the same:

- the machine, the path of the run folder, and its `campaign.toml`: both the text and the file itself. A folder that
  someone else made, unpacked at the same path or over this one, has another file, even with the same text;
- the path of the code's folder, and the sources in it that the campaign imports.

Of a program, the command in `campaign.toml` counts; the record warns if its files have changed. What cannot be checked
before it runs is not noted: a module outside the folder of the code, and a folder of code in the run folder itself,
which comes with it.

Nothing here fails a command. A note that cannot be read or written does not exist: the user is asked.
"""

import json
import os
import platform
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from activefail.campaign.variables import SetVariable
from activefail.errors import InputError
from activefail.record.layout import LARGEST_SETTINGS, SETTINGS
from activefail.simulators.code_folder import sha256
from activefail.simulators.user_code import SIMULATOR_KEY, digest_without_running, lies_in
from activefail.text.files import replacing
from activefail.text.trust import read_regular
from activefail.visible import quoted

if TYPE_CHECKING:
    from activefail.campaign.assembly import Campaign

_LARGEST_NOTE = 100_000
"""Largest note that is read [bytes]."""

_FAILURES = (OSError, ValueError, LookupError, TypeError, AttributeError, RuntimeError, MemoryError)
"""Errors of a note, or of the files that it names, that cannot be used."""


@dataclass(frozen=True)
class KnownCode:
    """Custom code that this user ran a campaign with.

    Attributes:
        folder: of the code.
        is_changed: whether the folder is another one behind a link, or a source in it has changed since.
        in_learner: whether what learns is part of the code, or needs records of a folder that the campaign names;
            otherwise only simulations need it.
    """

    folder: Path
    is_changed: bool
    in_learner: bool


def known_code(run: Path) -> KnownCode | None:
    """The code that this user ran the campaign of a run folder with; None if it is unknown or its folder is gone."""
    try:
        note = json.loads(read_regular(_note_of(run), _LARGEST_NOTE, private=True))
        if note["run"] != _identity(run):
            return None
        folder, sources = Path(note["code"]), dict(note["sources"])
        if not folder.is_absolute() or not folder.is_dir():
            return None
        is_same = os.path.realpath(folder) == note["real code"] and all(
            digest_without_running(reference, folder) == digest for reference, digest in sources.values()
        )
        return KnownCode(folder, not is_same, note["records"] or bool(sources.keys() - {SIMULATOR_KEY}))
    except _FAILURES:
        return None


def code_for(run: Path, *, simulates: bool, features: bool) -> Path | None:
    """The folder of the code to run for a run folder whose user named none; None if no code is known or needed.

    Args:
        run: the run folder.
        simulates: whether the simulator may be needed.
        features: whether features that are a Python function are needed.

    Raises:
        InputError: if the code has changed since the user agreed to it.
    """
    known = known_code(run)
    if known is None or not (simulates or (features and known.in_learner)):
        return None
    if known.is_changed:
        command = f"activefail resume {quoted(run)} --code {quoted(known.folder)}"
        raise InputError(
            f"{run}: the custom code in {known.folder} has changed since activefail last ran this campaign with it. "
            f"Name the folder again to run the changed code: --code {quoted(known.folder)}, as in `{command}`, or "
            f"code={str(known.folder)!r} in Python."
        )
    return known.folder


def remember_code(run: Path, campaign: "Campaign") -> None:
    """Note the code that a user named for a campaign and that activefail loaded; an older note is replaced.

    Args:
        run: the run folder.
        campaign: as it was assembled with the code.
    """
    code, references = campaign.code, campaign.functions
    if code is None or not campaign.settings.needs_code:
        return
    with suppress(*_FAILURES):
        path = _note_of(run)
        digests = {key: digest_without_running(reference, code) for key, reference in references.items()}
        is_same = all(campaign.sources[key] == digest != "" for key, digest in digests.items())
        if lies_in(code, run) or not is_same:
            path.unlink(missing_ok=True)
            return
        note = {
            "run": _identity(run),
            "code": str(code),
            "real code": os.path.realpath(code),
            "records": any(isinstance(entry, SetVariable) for entry in campaign.settings.space.values()),
            "sources": {key: (reference, digests[key]) for key, reference in references.items()},
        }
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with replacing(path) as file:
            os.fchmod(file.fileno(), 0o600)
            json.dump(note, file, indent=1)


def _note_of(run: Path) -> Path:
    """The file of a run folder's note; each has its own, so that campaigns that start together lose none.

    Raises:
        RuntimeError: if the user has no home.
    """
    state = Path(os.environ.get("XDG_STATE_HOME", ""))
    if not state.is_absolute():
        state = Path.home() / ".local" / "state"
    if not state.is_absolute():
        raise RuntimeError("The home is relative to the current folder, which may come from someone else.")
    return state / "activefail" / f"code-{sha256(os.fsencode(os.path.realpath(run)))[:32]}.json"


def _identity(run: Path) -> dict[str, Any]:
    """What distinguishes a run folder from any other, also from a later one at its path.

    An archive restores the time of modification of a file, but nobody chooses the time of its last change.

    Raises:
        OSError, ValueError: if its `campaign.toml` cannot be read.
    """
    text, status = read_regular(run / SETTINGS, LARGEST_SETTINGS), os.lstat(run / SETTINGS)
    return {
        "machine": platform.node(),
        "folder": os.path.realpath(run),
        "campaign": sha256(text),
        "inode": status.st_ino,
        "changed": status.st_ctime_ns,
    }
