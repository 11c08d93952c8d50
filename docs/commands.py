"""Writes docs/reference/commands.md, the reference of the command line, from the program itself.

python docs/commands.py
"""

import re
from collections import Counter
from pathlib import Path
from typing import Any

import typer

from activefail.cli import app
from activefail.seismic.settings import BearingSettings

DOCS = Path(__file__).parent
PAGE = DOCS / "reference" / "commands.md"

HEAD = """# Command line

Every command with an example, as `activefail COMMAND --help` shows it ([what commands are for](../guide.md#campaigns)).
In place of a CSV file, `-` is standard input or output.

## In several commands

Every command takes `-q` (`--quiet`) and `-v` (`--verbose`), which show [less or more](../guide.md#campaigns).

"""

MODEL = [f"--{name.replace('_', '-')}" for name in BearingSettings.model_fields]
"""Options that are keys of `[bearing]` in a campaign file, where they are explained."""


def linked(text: str) -> str:
    """A help text with links to the pages that it names."""
    text = re.sub("; - is standard (in|out)put", "", text).replace("<", r"\<").replace("*", r"\*")
    # A long list of names has room for a line's end.
    text = re.sub(r"\b\w+(?:,\w+){3,}", lambda names: names[0].replace(",", ", "), text)
    return re.sub(r"docs/([\w./]+\.md)", lambda page: f"[{page[1]}](../{page[1]})", text)


def command_rows(name: str, command: Any) -> dict[str, str]:
    """The row of each argument and option of a command, with its first name."""
    context = command.make_context(f"activefail {name}", [], resilient_parsing=True)
    found = {}
    for parameter in command.get_params(context):
        if parameter.name not in ("help", "quiet", "verbose"):
            declared, text = parameter.get_help_record(context)
            row = f"- `{declared.replace(' range>', '>')}`: {linked(' '.join(text.split()))}"
            found[row] = declared.split()[0].rstrip(",")
    return found


def command_section(name: str, command: Any, common: set[str]) -> str:
    """A command's section: an example, what it does, and a list of its arguments and options.

    Args:
        name: of the command.
        command: as typer has it.
        common: rows that are not in the list, because several commands have them.
    """
    rows = command_rows(name, command)
    lines = [f"## {name}", "", f"    {command.epilog.removeprefix('Example: ')}", "", linked(command.help), ""]
    if special := [row for row in rows if row not in common]:
        lines += [*special, ""]
    names = [rows[row] for row in rows if row in common and rows[row].startswith("--")]
    if options := [f"`{name}`" for name in names if name not in MODEL]:
        model = "the options of [the bearing's model](#in-several-commands), " if MODEL[0] in names else ""
        lines += [f"Also: {model}{', '.join(options)}.", ""]
    return "\n".join(lines)


def page() -> str:
    """commands.md for the program as it is."""
    commands = typer.main.get_command(app).commands
    counts = Counter(row for name, command in commands.items() for row in command_rows(name, command).items())
    meanings = Counter(first for _, first in counts)
    # An option with several meanings is explained in each command.
    common = {
        row: first for (row, first), count in counts.items() if count > 1 and (meanings[first] == 1 or first[0] != "-")
    }
    explained = [row for row, first in common.items() if first not in MODEL]
    names = ", ".join(f"`{name}`" for name in MODEL)
    explained.append(f"- {names}: as the keys of [`[bearing]`](settings.md#bearing); also `--no-loss-of-confinement`.")
    sections = (command_section(name, command, set(common)) for name, command in commands.items())
    return HEAD + "\n".join(explained) + "\n\n" + "\n".join(sections)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
