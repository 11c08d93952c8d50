"""Print the text of a page, without its pictures and scripts."""

import html
import re
import sys

with open(sys.argv[1], encoding="utf-8") as file:
    page = file.read()
page = re.sub(r"<(svg|script|style|head)\b.*?</\1>", "", page, flags=re.S)
page = re.sub(r"</(tr|p|li|h\d|dt|dd|figcaption|caption|div|section)>", "\n", page)
text = html.unescape(re.sub(r"<[^>]*>", " ", page))
print("\n".join(" ".join(line.split()) for line in text.splitlines() if line.strip()))
