"""The command line: parse, call, print."""

from activefail.cli.app import app, main
from activefail.cli.campaigns import export, predict, resume, run, status, verify
from activefail.cli.simulate import simulate
from activefail.cli.studies import compare, paper

# In the order of `activefail --help`.
for _command in (simulate, run, resume, status, predict, verify, export, compare, paper):
    app.command()(_command)

__all__ = ["app", "main"]
