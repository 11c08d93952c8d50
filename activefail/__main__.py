"""`python -m activefail`: the same as `activefail`."""

from activefail.cli import program

program()
