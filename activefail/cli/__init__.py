"""The command line: parse, call, print."""

from activefail.cli.app import Command, app, ends_on_ctrl_c, main, program, with_verbosity
from activefail.cli.campaigns import campaigns, export, predict, resume, run, status, verify
from activefail.cli.design import design
from activefail.cli.doctor import doctor
from activefail.cli.elsewhere import add, ask, create, drop, tell
from activefail.cli.explore import explore
from activefail.cli.fragility import fragility
from activefail.cli.hazard import hazard
from activefail.cli.ida import ida
from activefail.cli.probability import probability
from activefail.cli.report import report
from activefail.cli.sensitivity import sensitivity
from activefail.cli.simulate import simulate
from activefail.cli.studies import compare, paper

# In the order of `activefail --help`.
for _command in (
    simulate,
    campaigns,
    run,
    resume,
    status,
    create,
    ask,
    tell,
    drop,
    add,
    predict,
    verify,
    probability,
    hazard,
    design,
    sensitivity,
    fragility,
    ida,
    export,
    compare,
    report,
    explore,
    paper,
    doctor,
):
    app.command(cls=Command)(ends_on_ctrl_c(with_verbosity(_command)))

__all__ = ["app", "main", "program"]
