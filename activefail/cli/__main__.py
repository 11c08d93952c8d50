"""`python -m activefail.cli`: the same as `activefail`."""

from activefail.cli import program

program()
