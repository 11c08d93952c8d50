"""Features of choices from a file beside the campaign file."""

from pathlib import Path

from activefail.campaign.sections import Variable
from activefail.campaign.settings import CampaignSettings
from activefail.csv_table import Table
from activefail.errors import InputError, naming
from activefail.parameter import MOST_WITH_FEATURES
from activefail.trust import path_beside


def with_features(settings: CampaignSettings, folder: Path | None) -> CampaignSettings:
    """The settings with the numbers of their files of features, as a run folder has them.

    Args:
        settings: of a campaign.
        folder: of the campaign file, in which the names of files begin.

    Raises:
        InputError: naming the variable, the file, the row, the rule and the value.
    """
    for name, file in settings.feature_files.items():
        entry = settings.space[name]
        assert isinstance(entry, Variable)
        with naming(f"space.{name}.features: "):
            numbers = _numbers(name, entry, path_beside(folder or Path.cwd(), file, "campaign file"))
        settings = settings.changed({f"space.{name}.features": numbers}, f"with {file}")
    return settings


def _numbers(name: str, entry: Variable, path: Path) -> dict[str, list[float]]:
    """By column of a file, the number of each choice of a variable."""
    table, one = Table.of_csv(path, MOST_WITH_FEATURES), entry.parameter(name, 0.0)
    table.require([name])
    names = [column for column in table.columns if column != name]
    rows: dict[float, int] = {}
    for row in range(len(table.rows)):
        choice = table.value(row, one)
        if choice in rows:
            rule = f"must be another choice than in {table.places[rows[choice]]}"
            raise table.broken(row, name, rule, one.written(choice))
        rows[choice] = row
    if missing := [one.written(choice) for choice in one.values.tolist() if choice not in rows]:
        raise InputError(f"{path}: must have a row for each choice, but lacks {', '.join(map(str, missing))}.")
    return {column: [table.finite(rows[choice], column) for choice in one.values.tolist()] for column in names}
