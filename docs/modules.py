"""Writes docs/reference/modules.md, the list of modules, templates and scripts, from the first lines of each.

The first line of a template or script is a comment in place of a docstring.

python docs/modules.py
"""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "activefail"
PAGE = ROOT / "docs" / "reference" / "modules.md"

HEAD = """# Modules

What each module, template and script is for, in its own words. `python docs/modules.py` writes this page. The map in
[CONTRIBUTING.md](../../CONTRIBUTING.md) shows the packages and which of them may import which.
"""


def summary(file: Path) -> str:
    """The first sentence or two of a module, template or script: the first paragraph of its docstring, on one line."""
    text = file.read_text(encoding="utf-8")
    if file.suffix != ".py":
        comment = re.match(r"(?:\{#-?|//) (.*?)(?: -?#\}|\n)", text)
        return comment[1] if comment else ""
    return " ".join((ast.get_docstring(ast.parse(text)) or "").split("\n\n")[0].split())


def package(folder: Path) -> str:
    """A package's section: its summary, and one line for each of its modules."""
    name = folder.relative_to(ROOT).as_posix()
    files = sorted(
        file for file in folder.iterdir() if file.suffix in (".py", ".j2", ".js") and file.name != "__init__.py"
    )
    lines = [f"- `{file.name}`: {summary(file)}" for file in files]
    return "\n".join([f"\n## {name}/", "", summary(folder / "__init__.py"), "", *lines]) + "\n"


def page() -> str:
    """modules.md for the modules as they are."""
    folders = sorted(file.parent for file in PACKAGE.rglob("__init__.py"))
    return HEAD + "".join(map(package, folders))


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
