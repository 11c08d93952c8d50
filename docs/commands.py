"""Writes docs/reference/commands.md, the reference of the command line, from the program itself.

python docs/commands.py
"""

import re
from pathlib import Path
from typing import Any

import typer

from activefail.cli import app

DOCS = Path(__file__).parent
PAGE = DOCS / "reference" / "commands.md"

HEAD = """# Command line

Every command with its arguments and options, as `activefail COMMAND --help` shows them. Every command also takes
`-q` (`--quiet`) and `-v` (`--verbose`); [the guide](../guide.md#quiet-verbose-completion) says what they do.
The guide also says [what the commands are for](../guide.md#campaigns), and lists the
[exit codes](../guide.md#extra-simulations-exit-codes-ctrl-c). `python docs/commands.py` writes this page.

"""


def linked(text: str) -> str:
    """A help text with links to the pages that it names, fit for a cell of a table."""
    text = text.replace("|", r"\|").replace("<", r"\<").replace("*", r"\*")
    # A long list of names has room for a line's end.
    text = re.sub(r"\b\w+(?:,\w+){3,}", lambda names: names[0].replace(",", ", "), text)
    return re.sub(r"docs/([\w./]+\.md)", lambda page: f"[{page[1]}](../{page[1]})", text)


def command_section(name: str, command: Any) -> str:
    """A command's section: what it does, how it is called, and a table of its arguments and options."""
    context = command.make_context(f"activefail {name}", [], resilient_parsing=True)
    usage = command.get_usage(context).removeprefix("Usage: ")
    common = ("help", "quiet", "verbose")
    parameters = [parameter for parameter in command.get_params(context) if parameter.name not in common]
    rows = []
    for parameter in parameters:
        declared, text = parameter.get_help_record(context)
        rows.append(f"| `{declared.replace('|', chr(92) + '|')}` | {linked(' '.join(text.split()))} |")
    table = ["| argument or option | meaning |", "|---|---|", *rows] if rows else ["It takes no arguments."]
    example = command.epilog.removeprefix("Example: ")
    lines = [f"## {name}", "", f"    {' '.join(usage.split())}", "", linked(command.help), "", *table, ""]
    return "\n".join([*lines, "For example:", "", f"    {example}"]) + "\n"


def page() -> str:
    """commands.md for the program as it is."""
    commands = typer.main.get_command(app).commands
    return HEAD + "\n".join(command_section(name, command) for name, command in commands.items())


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
