"""The program with one of its functions held: the function does its work over and over until a file lets it return.

What a test does meanwhile meets the program in the middle of that work, however fast the machine is. `python -m held
WORD...` is the command line; a variable of the environment says what is held, so that the processes which the program
starts, and which import this module too, hold it likewise. Each notes in a folder that it is there.
"""

import importlib
import itertools
import json
import os
import sys
from functools import wraps
from pathlib import Path
from typing import Any

VARIABLE = "ACTIVEFAIL_TESTS_HOLD"
OPEN = "open"
"""The file, beside the notes, that lets all of them return."""


def hold(place: str, folder: Path, passing: int) -> None:
    """Hold a function, like "activefail.loop.learning:learn_from", from its call after the first so many on."""
    module, _, names = place.partition(":")
    *path, name = names.split(".")
    owner: Any = importlib.import_module(module)
    for part in path:
        owner = getattr(owner, part)
    function, calls = getattr(owner, name), itertools.count(1)

    @wraps(function)
    def held(*arguments: Any, **options: Any) -> Any:
        number = next(calls)
        if number > passing:
            (folder / f"{os.getpid()}-{number}").touch()
            while not (folder / OPEN).exists():
                function(*arguments, **options)
        return function(*arguments, **options)

    setattr(owner, name, held)


if requested := os.environ.get(VARIABLE):
    _place, _folder, _passing = json.loads(requested)
    hold(_place, Path(_folder), _passing)

if __name__ == "__main__":
    from activefail.cli import program

    sys.argv[0] = "activefail"
    program()
