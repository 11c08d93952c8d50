"""Placeholders, `{name}` or `{name:format}`, in the command of a program and in its input files."""

import re
import shlex
import string
from collections.abc import Collection, Mapping
from difflib import get_close_matches
from itertools import pairwise
from pathlib import Path

from activefail.errors import InputError

LONGEST_NUMBER = 100
"""Largest width and precision in a format: memory and time grow with both."""

PATHS = {"here": "AF_HERE", "out": "AF_OUT"}
"""Placeholders of a command that are paths, and the environment variables that have the same value."""

_SHELLS = ("sh", "bash", "dash", "ksh", "zsh")
_OPERATORS = ("|", "||", "&", "&&", ";", "<", ">", ">>", "2>", "2>&1", "&>")
_WITH_SHELL = ("flock", "su", "runuser", "sg", "script")
"""Programs that give a shell what follows their option -c, also after operands."""

_IN_FILE = re.compile(r"(?<!\$)\{\{[^\W\d]\w*\}\}|(?<!\$)\{([^\W\d]\w*)(?::([^{}]*))?\}")
"""A placeholder in an input file, where all other braces and `${name}` stay; `{{name}}` stays as `{name}`."""

_PIECE = re.compile(r"""(?<!\S)#[^\n]*|\\.|'[^']*'|"(?:\\.|[^"\\])*"|\{\w+\}""", re.DOTALL)
"""Of a shell's script: a comment, an escape, a quotation, or a placeholder outside quotations."""

_HERE = re.compile(r"(?:\{here\}|\$AF_HERE|\$\{\{AF_HERE\}\})/")
"""The code's folder before a file in it."""


class Number(float):
    """A number whose default format has all digits, for the program to read the same number."""

    def __format__(self, form: str) -> str:
        return format(float(self), form) if form else repr(float(self))


Value = float | str
"""A number, or the text of a choice."""


def _value(value: Value) -> Value:
    """A value with this format; whole numbers and texts have it already."""
    return Number(value) if isinstance(value, float) else value


def check_command(command: str, quantities: Mapping[str, Value]) -> None:
    """Check that a command can be filled in.

    Args:
        command: the program and its arguments.
        quantities: examples of the variables and the fixed quantities by name, integers where they are whole numbers.
    """
    try:
        parts = shlex.split(command)
        if not parts:
            raise ValueError("must name a program")
        for part in parts:
            if part in _OPERATORS:
                raise ValueError(f"runs without a shell, to which {part} means something; write sh -c '...'")
            if variable := re.search(r"\$\{(\w+)", part):
                raise ValueError(f"write ${{{{{variable[1]}}}}} for the shell's own variable, or $AF_{variable[1]}")
            for _, name, form, _ in string.Formatter().parse(part):
                if name is not None:
                    _check(name, form or "", (*quantities, "out", "here"))
            part.format_map({**quantities, **dict.fromkeys(PATHS, "path")})
    except ValueError as error:
        raise InputError(f"simulator.command: {error}; got {command!r}.") from None


def _check(name: str, form: str, known: Collection[str]) -> None:
    if "{" in form:
        raise ValueError(f"the format of {{{name}}} must not contain braces")
    # Digits of any script, as Python accepts them.
    if any(len(digits.lstrip("0")) > 3 or int(digits) > LONGEST_NUMBER for digits in re.findall(r"\d+", form)):
        raise ValueError(f"the format of {{{name}}} must have a width and a precision of at most {LONGEST_NUMBER}")
    if name not in known:
        raise ValueError(
            f"{{{name}}} is unknown; use one of {', '.join(f'{{{name}}}' for name in known)}; double other braces"
        )


def arguments(command: str, design: Mapping[str, Value], paths: Mapping[str, Path]) -> list[str]:
    """The program and its arguments for a design.

    Args:
        command: as `check_command` accepts it.
        design: values of the variables and the fixed quantities.
        paths: values of `PATHS`.

    Raises:
        InputError: if a path contains what an argument may read as code.
    """
    parts = shlex.split(command)
    values = {name: _value(value) for name, value in design.items()}
    references = PATHS | {name: f"AF_{name}" for name, value in design.items() if isinstance(value, str)}
    values |= {name: str(path) for name, path in paths.items()}
    filled = []
    for place, part in enumerate(parts):
        is_script = _is_shell_script(parts[:place])
        # Of a script, what is quoted with blanks may be code for another program.
        code = [text for text in _PIECE.findall(part) if text[0] in "'\""] if is_script else [part]
        for name in references if is_script else paths:
            text = next((text for text in code if f"{{{name}}}" in text and re.search(r"[\s(]", text)), None)
            unsafe = rf"""['"`$\\;&|<>*?!\n{" ()" if is_script else ""}]"""
            if text is not None and re.search(unsafe, str(values[name])):
                raise InputError(
                    f"simulator.command: {values[name]!r} contains characters that {text!r} may read as code; use the "
                    f"environment variable {references[name]} there instead of {{{name}}}."
                )
        filled.append((_by_environment(part, references) if is_script else part).format_map(values))
    return filled


def _is_shell_script(before: list[str]) -> bool:
    """Whether the argument after these is a shell's script: that of `sh -c`, `flock FILE -c`, `su --command`."""
    *words, option = before or [""]
    places = [place for place, word in enumerate(words) if Path(word).name in (*_SHELLS, *_WITH_SHELL)]
    if not places or not re.fullmatch(r"-\w*c|--command", option):
        return False
    # After an operand, the file of a script, a shell's options are those of the script.
    takes_operands = Path(words[places[-1]]).name in _WITH_SHELL
    options = pairwise(words[places[-1] :])
    return takes_operands or all(
        word.startswith(("-", "+")) or re.match(r"[-+]\w*o$", former) for former, word in options
    )


def _by_environment(script: str, references: Mapping[str, str]) -> str:
    """A script for a shell with references to the environment in place of paths and texts.

    A shell expands a reference in double quotes to one word, whatever it contains, and never runs it. In a comment it
    stays, and in a line of a file within the script that begins like a comment it is expanded.

    Args:
        script: the script.
        references: names of placeholders, and of the variables of the environment.
    """

    def filled(piece: re.Match[str]) -> str:
        text, quote = piece[0], piece[0][0]
        for name, variable in references.items():
            reference = f"${{{{{variable}:?}}}}"
            by_quote = {'"': reference, "#": reference, "'": f"'\"{reference}\"'"}
            text = text.replace(f"{{{name}}}", by_quote.get(quote, f'"{reference}"'))
        return text

    return _PIECE.sub(filled, script)


def check_file(text: str, quantities: Mapping[str, Value]) -> list[str]:
    """The quantities that an input file asks for, among these with examples of their values.

    Raises:
        ValueError: if it asks for none, or one has a wrong name or format; the text completes "<file>: ...".
    """
    asked = []
    for name, form in _IN_FILE.findall(text):
        if not name:
            continue
        if name in quantities:
            _check(name, form, quantities)
            format(quantities[name], form)
            asked.append(name)
        elif near := [one for one in quantities if one.lower() == name.lower()] or get_close_matches(
            name, quantities, 1, 0.75
        ):
            raise ValueError(
                f"{{{name}}} is unknown; did you mean {{{near[0]}}}? Double braces that stay: {{{{{name}}}}}"
            )
    if not asked:
        raise ValueError(f"must ask for a quantity, like {{{next(iter(quantities))}}}")
    return list(dict.fromkeys(asked))


def filled_file(text: str, design: Mapping[str, Value]) -> str:
    """An input file with the values of a design; other braces stay; double braces become single."""

    def filled(found: re.Match[str]) -> str:
        if found[1] is None:
            return found[0][1:-1]
        return format(_value(design[found[1]]), found[2] or "") if found[1] in design else found[0]

    return _IN_FILE.sub(filled, text)


def named_in(text: str, folder: Path) -> list[Path]:
    """The files in a folder that a script names, also below another folder, $here/a.tcl, but not where output goes."""
    beside, found = {path.name for path in folder.iterdir()}, set()
    for word in set(re.split(r"[^\w./+-]+", re.sub(r">\s*\S+", " ", text))):
        parts = word.split("/")
        found |= {folder.joinpath(*parts[k:]) for k, part in enumerate(parts) if part in beside}
    return [path for path in sorted(found) if path.is_file()]


def words_of(command: str) -> set[str]:
    """The words of a command that may name files or modules, also those in its scripts, but not where output goes.

    `{here}/` becomes `./`.
    """
    try:
        lexer = shlex.shlex(command, posix=True, punctuation_chars=True)
        lexer.whitespace_split, lexer.commenters = True, ""
        words = list(lexer)
    except ValueError:  # an apostrophe in a comment, or another language than a shell's
        words = re.sub(r"['\"]", " ", command).split()
    found = set()
    for before, word in pairwise(["", *words]):
        if before.startswith(">"):
            continue
        is_script = word != command and re.search(r"[\s'\"()]", word)
        found |= words_of(word) if is_script else set()
        for text in (word,) if is_script else (word, *re.split("[=:,;]", word)):
            lead, *path = _HERE.split(text, 1)
            found.add(f"./{path[0]}" if path and not (lead and is_script) else text)
    return found
