"""Writes docs/reference/settings.md, the keys of campaign, question and hazard files, from the settings themselves.

python docs/settings.py
"""

import inspect
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from activefail.campaign import sections, settings, variables
from activefail.campaign.settings import CampaignSettings
from activefail.seismic import settings as bearing_settings
from activefail.seismic.hazard import sections as hazard_sections

PAGE = Path(__file__).parent / "reference" / "settings.md"

HEAD = """# Keys of the files

Every key of [campaign](../guide.md#campaigns) and [hazard](../hazard.md) files, with its type and rule and, after a
semicolon, its default. A [question file](../probability.md#other-distributions) has the keys of
[`[question]`](#question). Unknown keys, infinite numbers and NaN are refused.
"""

FILES = {
    "Campaign file": CampaignSettings,
    "Hazard file": hazard_sections.HazardSettings,
}

TYPES = {"string": "text", "boolean": "true or false", "integer": "whole number", "number": "number", "object": "table"}

RULES = {"exclusiveMinimum": "> ", "minimum": "≥ ", "exclusiveMaximum": "< ", "maximum": "≤ "}

Schema = dict[str, Any]


def section_class(name: str) -> type:
    """The class of a section by its name."""
    modules = (settings, sections, variables, bearing_settings, hazard_sections)
    return next(vars(one)[name] for one in modules if name in vars(one))  # type: ignore[no-any-return]


def meanings(section: type) -> dict[str, str]:
    """What the keys of a section mean, as its docstring and those of its bases say."""
    found: dict[str, str] = {}
    for one in reversed(section.__mro__):
        _, _, text = inspect.cleandoc(one.__doc__ or "").partition("Attributes:\n")
        for names, meaning in re.findall(r"^    (\w[\w, ]*): (.*(?:\n {8}.*)*)", text, re.MULTILINE):
            text = " ".join(meaning.split())
            found |= dict.fromkeys(names.split(", "), text[0].upper() + text[1:])
    return found


def cited(text: str) -> str:
    """A text with links for the keys of docs/references.bib."""
    return re.sub(r"\[([A-Z][A-Za-z]+\d{4})((?:, [^\]]*)?)\]", r"[\1\2](../references.md#\1)", text)


def number(value: float) -> str:
    """A bound as people write it."""
    text = f"{value:,}" if isinstance(value, int) else f"{value:g}"
    return "2⁶³" if value == 2**63 else re.sub(r"e([+-])0*(\d+)", lambda e: "e" + e[1].strip("+") + e[2], text)


def rule(schema: Schema) -> str:
    """The type of a value and the rules for it."""
    kinds = [one for one in schema.get("anyOf", schema.get("oneOf", [])) if one.get("type") != "null"]
    if kinds:
        tables = ["table" for one in kinds if "$ref" in one][:1]
        return " or ".join(dict.fromkeys([*(rule(one) for one in kinds if "$ref" not in one), *tables])) or "table"
    if "$ref" in schema:
        return "table"
    if "enum" in schema or "const" in schema:
        return ", ".join(f"`{json.dumps(one)}`" for one in schema.get("enum", [schema.get("const")]))
    if schema["type"] == "array":
        parts = schema.get("prefixItems", [])
        inner = ", ".join(map(rule, parts)) if parts else rule(schema["items"])
        least, most = schema.get("minItems", 0), schema.get("maxItems")
        count = (
            "" if parts or not (least or most) else f", {least} to {number(most)}" if most else f", at least {least}"
        )
        return f"list of ({inner}){count}" if "," in inner or " of " in inner else f"list of {inner}{count}"
    if isinstance(values := schema.get("additionalProperties"), dict):
        return f"table of name = {rule(values)}"
    if schema.keys() >= {"minimum", "maximum"}:
        return f"{TYPES[schema['type']]}, {number(schema['minimum'])} to {number(schema['maximum'])}"
    rules = [sign + number(schema[key]) for key, sign in RULES.items() if key in schema]
    if "maxLength" in schema:
        rules.append(f"at most {schema['maxLength']} characters")
    return ", ".join([TYPES[schema["type"]], *rules])


def default(name: str, schema: Schema, required: list[str]) -> str:
    """What follows the type of a key: its default, as a file would state it, or that it is required."""
    if name in required:
        return "; required"
    value = schema.get("default")
    if value is None or "$ref" in schema:
        return ""
    return f"; `{number(value) if isinstance(value, float) else json.dumps(value)}`"


def references(schema: Schema) -> list[str]:
    """The names of the tables that a value may be."""
    return re.findall(r'"\$ref": "#/\$defs/(\w+)"', json.dumps(schema))


def rows(section: type, schema: Schema, said: dict[str, str] | None = None) -> list[str]:
    """The list of a section's keys, and the keys that are as in another section.

    Args:
        section: its class.
        schema: its JSON schema.
        said: rows of sections that may take its place, with the title of each; grows.

    Raises:
        KeyError: if its docstring does not say what a key means.
    """
    meaning = meanings(section)
    lines, before = [], dict[str, list[str]]()
    for name, entry in schema["properties"].items():
        if name not in meaning:
            raise KeyError(f"the docstring of {section.__name__} does not say what {name!r} means")
        row = f"- `{name}` ({rule(entry)}{default(name, entry, schema.get('required', []))}): {meaning[name]}"
        if said and row in said:
            before.setdefault(said[row], []).append(f"`{name}`")
        else:
            lines.append(row)
    if said is not None:
        said |= dict.fromkeys(lines, schema.get("required", [""])[0])
    same = [
        f"{', '.join(names[:-1])} and {names[-1]} are as with `{title}`."
        if names[1:]
        else f"{names[0]} is as with `{title}`."
        for title, names in before.items()
    ]
    return [*lines, "", *same] if same else lines


def tables(
    schema: Schema, path: str, defined: dict[str, Schema], seen: set[str], said: dict[str, str] | None = None
) -> Iterator[str]:
    """The sections of the page on a table and on the tables inside it, each once.

    Args:
        schema: JSON schema of the table.
        path: of the table in a file, such as "classifier"; empty for the file itself.
        defined: schemas of the tables inside it, by name.
        seen: names of the tables that the page already has; grows.
        said: rows of tables that may take its place; grows.
    """
    section = section_class(schema["title"])
    if path:
        summary = " ".join(inspect.cleandoc(section.__doc__ or "").split("\n\n")[0].split())
        yield "\n".join([f"### {path}", "", cited(summary), "", *rows(section, schema, said)])
    else:
        yield "\n".join(rows(section, schema))
    for name, entry in schema["properties"].items():
        inside, alternatives = references(entry), dict[str, str]()
        for inner in [one for one in inside if one not in seen]:
            seen.add(inner)
            own = defined[inner].get("required", [])
            key = ".".join([*path.strip("`[]").split("."), name]).lstrip(".")
            key += ".NAME" if "additionalProperties" in entry else ""
            heading = f"`[{key}]`" + (f" with `{own[0]}`" if len(inside) > 1 and own else "")
            yield from tables(defined[inner], heading, defined, seen, alternatives if len(inside) > 1 else None)


def page() -> str:
    """settings.md for the settings as they are."""
    text, seen = HEAD, set[str]()
    for heading, model in FILES.items():
        schema = model.model_json_schema()
        parts = tables(schema, "", schema.get("$defs", {}), seen)
        text += f"\n## {heading}\n\n" + "\n\n".join(parts) + "\n"
    return text


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
