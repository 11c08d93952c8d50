"""The command line: parse, call, print."""

from collections.abc import Callable

from activefail.cli.analyses import command_of, explore
from activefail.cli.app import Command, app, main, program
from activefail.cli.campaigns import campaigns, export, predict, resume, run, status
from activefail.cli.check import check
from activefail.cli.doctor import doctor
from activefail.cli.elsewhere import add, ask, create, drop, tell
from activefail.cli.options import with_options
from activefail.plugins import brought
from activefail.run.analyses import compare, design, fragility, probability, report, sensitivity, verify

_EXAMPLES: dict[Callable[..., None], str] = {
    campaigns: "--copy mine",
    check: "campaign.toml",
    run: "paper --out runs/first",
    resume: "runs/first --budget 600",
    status: "runs/first",
    create: "campaign.toml --out runs/laboratory",
    ask: "runs/laboratory --n 10 --csv designs.csv",
    tell: "runs/laboratory --csv results.csv",
    drop: "runs/laboratory --ids 12,15",
    add: "runs/laboratory --csv last_year.csv",
    predict: "runs/first --csv designs.csv --out predictions.csv",
    **command_of(verify),
    **command_of(probability),
    **command_of(design),
    **command_of(sensitivity),
    **command_of(fragility),
    export: "runs/first --csv simulations.csv",
    **command_of(compare),
    **command_of(report),
    explore: "runs/first",
    doctor: "",
    **brought("commands"),
}
"""The commands in the order of `activefail --help`, with the example that each one's help ends with."""

for _command, _words in _EXAMPLES.items():
    _example = f"Example: activefail {_command.__name__} {_words}".rstrip()
    app.command(cls=Command, epilog=_example)(with_options(_command))

__all__ = ["app", "main", "program"]
