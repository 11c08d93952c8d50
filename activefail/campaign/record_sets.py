"""Variables whose values are the records of a set: what a campaign freezes of them, and the motions behind them."""

from dataclasses import replace
from pathlib import Path

from activefail.campaign.sections import SetVariable
from activefail.campaign.settings import CampaignSettings
from activefail.errors import InputError
from activefail.motions import Motions, read_motions
from activefail.space import DesignSpace


def with_records(settings: CampaignSettings, folder: Path | None, may_read: bool = True) -> CampaignSettings:
    """The settings with the names, events and digest of the records of their sets, as a run folder has them.

    Args:
        settings: of a campaign; sets whose records they have are not read.
        folder: of the campaign file, in which folders of records begin.
        may_read: whether folders may be read; if not, the settings may come from someone else.

    Raises:
        InputError: naming the variable, the rule and the value.
    """
    space = dict(settings.space)
    for name, entry in settings.space.items():
        if isinstance(entry, SetVariable) and entry.records is None:
            if not may_read:
                raise InputError(f"space.{name}.set: requires `records` and `digest`, as activefail writes them.")
            beside = (folder or Path.cwd()) / entry.set
            place = str(beside.absolute()) if beside.exists() else entry.set
            found = read_motions(name, place, entry.unit, entry.dt)
            events = {record.name: record.event for record in found.records}
            known = entry.model_copy(update={"set": place, "digest": found.digest, "records": events})
            fault = known.fault
            if entry.digest not in (None, found.digest):
                fault = f"the digest of {entry.set} must be {entry.digest}, as `digest` says, got {found.digest}"
            if len(events) < len(found.records):
                fault = f"the {len(found.records)} records of {entry.set} must have different names"
            if fault:
                raise InputError(f"space.{name}.set: {fault}.")
            space[name] = known
    return settings.model_copy(update={"space": space})


def space_with_motions(settings: CampaignSettings, may_read: bool = True) -> DesignSpace:
    """The design space of settings that have the records of their sets; these are read when they are needed.

    Args:
        settings: of a campaign.
        may_read: as for `with_records`.
    """
    space = settings.design_space()
    parameters = []
    for parameter in space.parameters:
        entry = settings.space[parameter.name]
        if isinstance(entry, SetVariable):
            assert entry.digest is not None
            level, measure = next(iter((entry.scaled_to or {"": "factor"}).items()))
            motions = Motions(parameter.name, entry.set, entry.unit, entry.dt, entry.digest, level, measure, may_read)
            parameter = replace(parameter, payload=motions)
        parameters.append(parameter)
    return replace(space, parameters=tuple(parameters))
