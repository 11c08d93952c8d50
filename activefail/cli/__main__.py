"""`python -m activefail.cli`: the same as `activefail`, under an older name."""

from activefail.cli import program

program()
