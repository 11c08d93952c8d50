"""A campaign that stands for any other: a formula says how two buildings that pound come through a pulse."""

import shutil
from pathlib import Path

from activefail.campaign.known_code import remember_code
from activefail.campaign.on_disk import open_campaign

NAMES = ("mu", "k", "T_g", "A_g")
SIMULATOR = """
simulator = { python = "pounding_model:run", outcomes = ["no_impact", "impact", "failure"] }
[space]
mu = { low = 0.02, high = 0.12 }
k = { low = 2.5e8, high = 5e9, unit = "N/m^1.5" }
T_g = { low = 0.25, high = 5.0, unit = "s" }
A_g = { low = 0.1, high = 0.8, unit = "g" }
"""
"""The end of a campaign file."""

CODE = Path(__file__).with_name("pounding_code")
"""The folder of the code."""


def write_campaign(file: Path, text: str) -> Path:
    """Write a campaign file, which begins with this text, and the code beside it; the file."""
    file.write_text(text + SIMULATOR, encoding="utf-8")
    shutil.copy(CODE / "pounding_model.py", file.parent)
    return file


def copied(folder: Path, target: Path, code: Path) -> Path:
    """A copy of a run folder whose code is known, as it is of the original; the copy."""
    shutil.copytree(folder, target)
    with open_campaign(target, write=False, code=code) as (campaign, _):
        remember_code(target, campaign)
    return target
