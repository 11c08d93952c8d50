"""Golden outputs: what the commands print for six small campaigns, as one transcript for each.

A transcript is a text of command lines, `$ activefail status run`, each followed by what it prints. `PYTHONPATH=tests
python -m golden.outputs [NAME...]` writes them anew; a change of a transcript is a change that users see.
"""

import contextlib
import re
import shlex
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np
from commandline import activefail

from activefail.campaign.provenance import provenance

HERE = Path(__file__).parent
CORE = ("asynchronous", "elsewhere", "margins", "rare")
SEISMIC = ("batch", "records")
"""Those on bearings."""
NAMES = (*CORE, *SEISMIC)

_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.]*\w)")
_VARYING = [
    (re.compile(r"\b(?:about |less than )?\d+(?:\.\d+)? (s|min|MB|ms)\b(?! pulses)"), r"<\1>"),
    (re.compile(r"\b[0-9a-f]{40,64}\b"), "<digest>"),
    (re.compile(r"\b20\d\d-\d\d-\d\d[T ]\d\d:\d\d(:\d\d)?\S*"), "<time>"),
    (re.compile(rf"^({'|'.join(provenance())})\n.*", re.M), r"\1\n<of this machine>"),
]


def command_lines(transcript: str) -> list[str]:
    """The command lines of a transcript."""
    return [line[2:] for line in transcript.splitlines() if line.startswith("$ ")]


def sections(transcript: str) -> dict[str, str]:
    """What each command line of a transcript prints."""
    parts = re.split(r"^\$ (.*)\n", transcript, flags=re.M)[1:]
    return dict(zip(parts[::2], parts[1::2], strict=True))


def prepare(folder: Path) -> None:
    """Campaign files, custom code and two records in a folder."""
    for file in (HERE / "files").iterdir():
        if file.is_file():
            (folder / file.name).write_bytes(file.read_bytes())
    code = HERE.parents[1] / "campaigns" / "bearing_records.py"
    (folder / code.name).write_bytes(code.read_bytes())
    (folder / "motions").mkdir()
    t = np.arange(0.0, 12.0, 0.02)
    for name, period, centre in (("near", 2.0, 4.0), ("far", 3.5, 6.0)):
        a = np.exp(-(((t - centre) / period) ** 2)) * np.sin(2 * np.pi * (t - centre) / period)
        text = "t_s,a_g\n" + "".join(f"{x:.2f},{y:.6f}\n" for x, y in zip(t, 0.4 * a, strict=True))
        (folder / "motions" / f"{name}.csv").write_text(text)


def output(line: str, folder: Path) -> str:
    """What a command line prints in a folder: standard output, standard error, and an exit code that is not 0."""
    program, *words = shlex.split(line)
    if program == "activefail":
        with contextlib.chdir(folder), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            done = activefail(*words)
        text, code = done.out + done.err, done.code
    else:
        ran = subprocess.run([sys.executable, *words], cwd=folder, capture_output=True, text=True, check=False)
        text, code = ran.stdout + ran.stderr, ran.returncode
    text = text.replace(str(folder), "<folder>") + (f"exit code {code}\n" if code else "")
    for pattern, instead in _VARYING:
        text = pattern.sub(instead, text)
    text = "\n".join(_without_seconds(text.split("\n")))
    return text if text.endswith("\n") or not text else text + "\n"


def _without_seconds(lines: list[str]) -> list[str]:
    """Lines of which those of a table have no wall times."""
    header = next((line.split(",") for line in lines if ",seconds" in line), None)
    if header is None:
        return lines
    place = header.index("seconds")
    rows = [line.split(",") for line in lines]
    return [",".join(row[:place] + row[place + 1 :]) if len(row) == len(header) else ",".join(row) for row in rows]


def transcript_of(name: str, former: str) -> str:
    """The transcript of a campaign as the program is now."""
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made).resolve()
        prepare(folder)
        return "".join(f"$ {line}\n{output(line, folder)}" for line in command_lines(former))


def differences(expected: str, printed: str, relative: float = 0.02) -> list[str]:
    """Where two texts differ: in words, or in numbers by more than a relative tolerance."""
    lines, others = expected.splitlines(), printed.splitlines()
    found = [] if len(lines) == len(others) else [f"{len(lines)} lines were expected, {len(others)} came"]
    for one, other in zip(lines, others, strict=False):
        numbers = [list(map(float, _NUMBER.findall(line))) for line in (one, other)]
        words = [_spaced(_NUMBER.sub("#", line)) for line in (one, other)]
        close = len(numbers[0]) == len(numbers[1]) and np.allclose(*numbers, rtol=relative, atol=1e-9)
        if words[0] != words[1] or not close:
            found.append(f"expected: {one}\nprinted:  {other}")
    return found


def _spaced(text: str) -> str:
    """A line whose columns may be a character wider."""
    return re.sub(r"[ ─━-]{2,}", "  ", text).strip()


if __name__ == "__main__":
    for chosen in sys.argv[1:] or NAMES:
        path = HERE / f"{chosen}.txt"
        path.write_text(transcript_of(chosen, path.read_text(encoding="utf-8")), encoding="utf-8")
