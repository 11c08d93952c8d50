"""The command line: parse, call, print."""

from collections.abc import Callable

from activefail.cli.analyses import command_of, explore
from activefail.cli.app import Command, app, ends_on_ctrl_c, main, program, with_verbosity
from activefail.cli.campaigns import campaigns, export, predict, resume, run, status
from activefail.cli.check import check
from activefail.cli.doctor import doctor
from activefail.cli.elsewhere import add, ask, create, drop, tell
from activefail.cli.simulate import simulate
from activefail.cli.studies import compare, paper
from activefail.requests import (
    DesignRequest,
    FragilityRequest,
    HazardRequest,
    IdaRequest,
    ProbabilityRequest,
    ReportRequest,
    SensitivityRequest,
    VerifyRequest,
)

_EXAMPLES: dict[Callable[..., None], str] = {
    simulate: "--t-b 4 --mu 0.06 --d-tot 0.6 --h-sl-ratio 0.6 --h-rim-ratio 0.1 --p 45 --k 2e9 --t-p 2.5 --a-p 0.5",
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
    command_of("verify", VerifyRequest): "runs/first --simulations 400",
    command_of("probability", ProbabilityRequest): "runs/first --question question.toml",
    command_of("hazard", HazardRequest): "hazard.toml runs/first --out figures",
    command_of("design", DesignRequest): "runs/first --hazard hazard.toml --target 0.02 --free D_tot",
    command_of("sensitivity", SensitivityRequest): "runs/first --hazard hazard.toml --out figures",
    command_of("fragility", FragilityRequest): "runs/first --hazard hazard.toml --bearing bearing.toml --out figures",
    command_of("ida", IdaRequest): "--records farfield --bearing bearing.toml --out figures",
    export: "runs/first --csv simulations.csv",
    compare: "runs/first --static 500,1000,2000",
    command_of("report", ReportRequest): "runs/first --out report.html",
    explore: "runs/first",
    paper: "--draws 4 --fresh 1000",
    doctor: "",
}
"""The commands in the order of `activefail --help`, with the example that each one's help ends with."""

for _command, _words in _EXAMPLES.items():
    _example = f"Example: activefail {_command.__name__} {_words}".rstrip()
    app.command(cls=Command, epilog=_example)(ends_on_ctrl_c(with_verbosity(_command)))

__all__ = ["app", "main", "program"]
