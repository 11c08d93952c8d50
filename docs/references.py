"""Writes docs/references.md from docs/references.bib.

python docs/references.py
"""

import re
from pathlib import Path
from urllib.parse import quote

HERE = Path(__file__).parent

HEAD = """# References

Every work that activefail cites, by its key. [references.bib](references.bib) also has all authors, journals and pages.

"""


def entries(text: str) -> dict[str, dict[str, str]]:
    """The fields of each entry of a .bib file, by key."""
    found = {}
    for key, body in re.findall(r"^@\w+\{(\w+),\n(.*?)^\}", text, re.MULTILINE | re.DOTALL):
        found[key] = dict(re.findall(r"(\w+) = \{(.*?)\}(?=,|\s*$)", body, re.MULTILINE))
    return found


def line(key: str, entry: dict[str, str]) -> str:
    """An entry as an item of a list, with an anchor of its key."""
    authors = entry.get("author", "").replace(" and others", " et al.").split(" and ")
    names = " and ".join(authors) if len(authors) < 3 else f"{authors[0]} et al."
    head = f"{names} ({entry['year']})" if "year" in entry else names
    kinds = ("journal", "booktitle", "publisher", "school", "institution")
    place = next((entry[kind] for kind in kinds if kind in entry), "")
    place = f"*{place}*" if place else ""
    for field in ("volume", "pages"):
        if field in entry:
            place += (" " if field == "volume" else ", ") + entry[field].replace("--", "–")
    doi = entry.get("doi", "")
    place = "" if doi else place
    link = f"[doi:{doi}](https://doi.org/{quote(doi, safe='/:;.()')})" if doi else ""
    parts = [part.rstrip(".") for part in (head, entry["title"], place, link, entry.get("note", "")) if part]
    return f'- <a id="{key}"></a>`{key}` {". ".join(parts)}.'


def page(text: str) -> str:
    """references.md for the text of references.bib."""
    return HEAD + "\n".join(line(key, entry) for key, entry in entries(text).items()) + "\n"


if __name__ == "__main__":
    (HERE / "references.md").write_text(page((HERE / "references.bib").read_text(encoding="utf-8")), encoding="utf-8")
