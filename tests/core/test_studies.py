"""The studies that the documentation names."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
STUDIES = {path.name: ast.parse(path.read_text(encoding="utf-8")) for path in (ROOT / "studies").glob("*.py")}
PAGES = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")]
COMMAND = re.compile(r"studies/(\w+\.py)((?:[^`\n]|\n(?! *\n))*)")
"""A study, and what follows in the same code: to the next mark or the end of the paragraph."""


def calls_of(tree, name):
    return [node for node in ast.walk(tree) if isinstance(node, ast.Call) and getattr(node.func, "id", "") == name]


def named():
    """Options by study, as the pages name them."""
    options = {}
    for page in PAGES:
        for study, rest in COMMAND.findall(page.read_text(encoding="utf-8")):
            options.setdefault(study, set()).update(re.findall(r"--[a-z][a-z-]*", rest))
    return options


def test_studies_that_pages_name_exist_and_take_the_options_that_are_named():
    for study, options in named().items():
        given = {keyword.arg for call in calls_of(STUDIES[study], "asked") for keyword in call.keywords}
        assert options <= {f"--{name.replace('_', '-')}" for name in given}, study


def test_every_study_is_named_on_a_page_or_imported_by_another():
    imported = set()
    for tree in STUDIES.values():
        for node in ast.walk(tree):
            match node:
                case ast.ImportFrom(module=str(module)):
                    imported.add(f"{module}.py")
                case ast.Import(names=names):
                    imported |= {f"{name.name}.py" for name in names}
    assert STUDIES.keys() <= named().keys() | imported
