"""The commands print what the transcripts of campaigns on custom simulators say."""

import pytest
from golden.outputs import CORE, HERE, differences, sections, transcript_of


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", CORE)
def test_commands_print_what_the_transcript_says(name: str) -> None:
    former = (HERE / f"{name}.txt").read_text(encoding="utf-8")
    expected, printed = sections(former), sections(transcript_of(name, former))
    wrong = {line: differences(text, printed[line]) for line, text in expected.items()}
    told = "\n".join(f"$ {line}\n" + "\n".join(d) for line, d in wrong.items() if d)
    assert not any(wrong.values()), told
