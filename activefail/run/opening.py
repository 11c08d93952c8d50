"""`create_run` and `open_run`: create a run folder, or open one, as a `Run`."""

import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from activefail.campaign.assembly import Campaign
from activefail.campaign.continuing import how_to_continue
from activefail.campaign.known_code import code_for, known_code, remember_code
from activefail.campaign.on_disk import campaign_file, create_folder, opened, read_campaign
from activefail.campaign.settings import CampaignSettings, checked, read_settings
from activefail.errors import InputError
from activefail.record.layout import SETTINGS, check_run_folder
from activefail.run.run import Run
from activefail.text.files import path_of

AnyPath = str | os.PathLike[str]


def create_run(
    folder: AnyPath,
    campaign: Campaign | AnyPath | Mapping[str, Any],
    *,
    code: AnyPath | None = None,
    remember: bool = True,
    exist_ok: bool = False,
) -> Run:
    """Create a run folder for a campaign, open for writing.

    Args:
        folder: to create.
        campaign: the path of a campaign file, or the name of a shipped one such as "paper"; or its settings as a
            dictionary, with the keys of a campaign file; or a campaign.
        code: folder of the user's code, which is executed. If None, the campaign file's folder; for a dictionary, the
            folder of the script that runs, or the current folder without a script.
        remember: whether later commands and `open_run` may run the same code for this folder without being told its
            folder (see `activefail.campaign.known_code`).
        exist_ok: open the folder if it already holds this very campaign.

    Raises:
        InputError: if the settings are invalid, or the folder is in use, with `exist_ok` by another campaign.
        BusyError, StoreError: if the folder cannot be written.
    """
    folder, code = path_of("folder", folder), None if code is None else path_of("code", code)
    if exist_ok and (folder / SETTINGS).exists():
        wanted = _described(folder, campaign, code=code)
        check_run_folder(folder)
        held = read_settings(folder / SETTINGS)
        if other := [key for key, value in wanted.settings if getattr(held, key) != value]:
            raise InputError(f"{folder}: holds another campaign: {', '.join(other)} differ. Choose another folder.")
        if code is None and not (remember and known_code(folder)):
            code = wanted.code
        return open_run(folder, write=True, code=code, remember=remember)
    campaign = campaign_for(folder, campaign, code=code)
    store = create_folder(folder, campaign)
    if remember:
        remember_code(folder, campaign)
    return Run(folder, campaign, store, write=True)


def campaign_for(
    folder: Path,
    campaign: Campaign | AnyPath | Mapping[str, Any],
    seed: int | None = None,
    budget: int | None = None,
    code: Path | None = None,
) -> Campaign:
    """The campaign for a run folder that does not exist yet.

    Args:
        folder: the run folder.
        campaign, code: as for `create_run`.
        seed, budget: replace those of a campaign file.

    Raises:
        InputError: if the settings are invalid, the folder already holds a campaign, or custom code of the classifier
            or of the criterion fails (see `loop.proposing.try_custom_code`).
    """
    campaign = _described(folder, campaign, seed, budget, code)
    if (folder / SETTINGS).exists():
        how = how_to_continue(folder, campaign)
        raise InputError(f"{folder}: already holds a campaign; {how}. In Python, `open_run` opens it.")
    if campaign.learner:
        from activefail.loop.proposing import try_custom_code

        try_custom_code(campaign)
    return campaign


def _described(
    folder: Path,
    campaign: Campaign | AnyPath | Mapping[str, Any],
    seed: int | None = None,
    budget: int | None = None,
    code: Path | None = None,
) -> Campaign:
    if isinstance(campaign, Mapping):
        return Campaign.of(checked(CampaignSettings, dict(campaign), "settings"), code or _script_folder(), folder)
    if isinstance(campaign, Campaign):
        return campaign
    file = campaign_file(path_of("campaign", campaign))
    return read_campaign(file, seed, budget, code=code or file.absolute().parent, run=folder)


def _script_folder() -> Path:
    """The folder in which Python looks for modules first: of the script, or the current one without a script."""
    main = sys.modules["__main__"]
    script = getattr(main, "__file__", None) if main.__spec__ is None else None
    return Path(script).parent if script else Path()


def open_run(
    folder: AnyPath,
    *,
    write: bool = False,
    code: AnyPath | None = None,
    features: bool = True,
    simulates: bool | None = None,
    remember: bool = True,
) -> Run:
    """Open a run folder.

    Args:
        folder: the run folder.
        write: make this process the only writer.
        code: folder of the user's code, which is executed. If None, the one that activefail remembers.
        features: whether features that are a Python function are needed.
        simulates: whether the simulator's function is needed; if None, where the run is open for writing.
        remember: whether to remember `code`, and to run the code that activefail remembers (see
            `activefail.campaign.known_code`). If false and `code` is None, no code runs.

    Raises:
        InputError: if the folder holds no campaign, its settings are invalid, or the remembered code has changed.
        StoreError: if the record cannot be read.
        BusyError: if another process is writing to it.
    """
    folder, named = path_of("folder", folder), code is not None
    known = None if code is None else path_of("code", code)
    if remember and not named:
        known = code_for(folder, simulates=write if simulates is None else simulates, features=features)
    campaign, store = opened(folder, write, known, features)
    # Without the features' function not all of the code was loaded.
    if remember and named and features:
        remember_code(folder, campaign)
    return Run(folder, campaign, store, write)
