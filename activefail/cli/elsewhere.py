"""Commands on simulations done elsewhere: create, ask, tell, drop, add."""

import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from activefail.cli.campaigns import BUDGET, SEED, TO_CREATE
from activefail.cli.common import (
    STANDARD,
    CampaignFile,
    Code,
    RunFolder,
    name_of,
    opened_run,
    show_unseen,
    show_warnings,
    shown_warnings,
    table_input,
    table_output,
)
from activefail.errors import InputError
from activefail.record.layout import check_output
from activefail.run.analysis import REQUIRED, option
from activefail.text.numerals import counted
from activefail.visible import quoted, visible

if TYPE_CHECKING:
    from pandas import DataFrame

    from activefail.run.run import Run

NAMES: Any = option(
    None,
    'What the table has in place of a name, such as "load=Load [N]/1000", "T=T_C + 273.15" (with blanks) or '
    '"failure=collapsed", or a TOML file with such lines; repeatable.',
    list[str],
    names=("--map",),
)
SKIP_INVALID: Any = option(False, "Leave out rows that break a rule, and name them.")


def create(
    campaign: CampaignFile,
    out: Path = TO_CREATE,
    seed: int | None = SEED,
    budget: int | None = BUDGET,
) -> None:
    """Create a run folder without simulating anything."""
    from activefail.campaign.continuing import ask_command, continue_command
    from activefail.run.opening import campaign_for, create_run

    check_output("--out", out)
    with create_run(out, campaign_for(out, campaign, seed, budget)) as created:
        show_warnings(created.store.new_warnings())
    print(f"created    {visible(str(out))}")
    made = created.campaign
    print(f"continue   {visible(continue_command(out, made))}")
    if not made.is_elsewhere:
        print(f"           {visible(ask_command(out, made))}, to have designs simulated elsewhere")


def ask(
    folder: RunFolder,
    csv: Path = option(REQUIRED, "Table of designs to write; - is standard output.", Path),
    n: int = option(1, "Number of designs.", names=("--n",), low=1, high=100_000),
    in_flight: bool = option(False, "Write the designs in flight again; hand out no others."),
    beyond: bool = option(False, "Hand out designs beyond the budget."),
    ignore_stop: bool = option(False, "Hand out designs even if the stop rule is met."),
    code: Code = None,
) -> None:
    """Hand out designs to be simulated elsewhere."""
    from activefail.space.parameter import exact
    from activefail.text.csv_table import writing

    with (
        table_output("--csv", csv) as target,
        opened_run(folder, write=not in_flight, code=code, simulates=False) as opened,
    ):
        space = opened.space
        if csv not in STANDARD:
            _check_replaceable(csv, opened)
        table: DataFrame | None = None
        try:
            with suppress(_NothingError), writing(target, ["id", *space.names, *space.fixed]) as write:
                # The table first: if it cannot be written, no design is handed out.
                table = opened.in_flight if in_flight else opened.ask(n, beyond=beyond, ignore_stop=ignore_stop)
                if not len(table) and csv not in STANDARD:
                    # An earlier table under this name may be the one that somebody works on.
                    raise _NothingError
                write([[int(cells[0]), *map(exact, cells[1:])] for cells in table.itertuples(index=False)])
        except (InputError, OSError):  # a full disk shows only now
            if table is not None and len(table) and not in_flight:
                again = f"activefail ask {quoted(folder)} --in-flight --csv FILE"
                print(f"{_numbers(table)} are in flight; `{again}` writes them again", file=sys.stderr)
            raise
        assert table is not None
        show_warnings(opened.store.new_warnings())
        waiting = opened.counts["in_flight"] - (0 if in_flight else len(table))
        if reason := table.attrs.get("reason", ""):
            print(f"{counted(len(table), 'design')} instead of {n}: {visible(reason)}", file=sys.stderr)
        if len(table):
            print(f"{_numbers(table)} written to {name_of(csv)}")
        else:
            print(f"no designs{'' if csv in STANDARD else ', so no table was written'}{_WAITING if waiting else ''}")


def _check_replaceable(path: Path, run: "Run") -> None:
    """Check that no results are lost with a table that will be replaced: somebody may have filled it in.

    Raises:
        InputError: if `tell` would record results of it, or refuses it and it is no table of designs alone.
    """
    from activefail.text.csv_table import likely_header

    if path.is_dir():
        raise InputError(f"--csv: {path} is a folder.")
    if not path.is_file():
        return
    try:
        if run.is_told(path):
            return
    except InputError:
        pass
    # What `tell` refuses may be a table of designs alone, also of another campaign. Any other file is somebody's work.
    header, results = set(likely_header(path)) - {""}, {"outcome", *run.campaign.simulator.margins}
    if {"id", *run.space.names} <= header:  # of designs that were handed out: any other column may be a result
        results = header - {"id", *run.space.names, *run.space.fixed}
    elif "id" not in header:
        results = results & header or header
    results &= header
    if not results or not path.stat().st_size:
        return
    raise InputError(
        f"--csv: {path} holds results that are not recorded ({', '.join(sorted(results))}): `tell` them first, or name "
        "another file."
    )


class _NothingError(Exception):
    """There is no design to write."""


_WAITING = "; --in-flight writes the designs in flight again"


def _numbers(table: "DataFrame") -> str:
    ids = table["id"].tolist()
    if len(ids) == 1:
        return f"1 design, id {ids[0]},"
    is_run = ids[-1] - ids[0] == len(ids) - 1
    return f"{len(ids)} designs, ids {f'{ids[0]} to {ids[-1]}' if is_run else ', '.join(map(str, ids))},"


def tell(
    folder: RunFolder,
    csv: Path = option(REQUIRED, "Table of results, with the column id; - is standard input.", Path),
    correct: bool = option(False, "Replace recorded results that were wrong; the former ones are kept."),
    changed: bool = option(False, "Record the designs in the table, such as rounded ones, as simulated."),
    names: list[str] | None = NAMES,
    skip_invalid: bool = SKIP_INVALID,
    code: Code = None,
) -> None:
    """Record the results of designs that were handed out."""
    with opened_run(folder, write=True, code=code, simulates=False) as opened:
        with shown_warnings():
            new = opened.tell(
                table_input(csv), correct=correct, changed=changed, names=_names(names), skip_invalid=skip_invalid
            )
        left, summary = opened.counts["in_flight"], opened.summary
        if correct:
            _show_corrections(opened, new)
    if correct:
        print(f"{counted(new, 'result')} corrected")
    else:
        print(f"{counted(new, 'new result')} recorded; {counted(left, 'design')} in flight")
    show_unseen(summary)


def _names(texts: list[str] | None) -> dict[str, str]:
    """The names in options `--map`: name=text, or a TOML file of such pairs.

    Raises:
        InputError: if a text is neither.
    """
    from activefail.text.toml import read_toml

    names: dict[str, str] = {}
    for text in texts or ():
        name, sign, of = text.partition("=")
        found = {name.strip(): of.strip()} if sign else read_toml(Path(text))
        for key, value in found.items():
            if not (key and value and isinstance(value, str)):
                raise InputError(f'--map: must be "name=column" or a TOML file of such texts, got {key!r} = {value!r}.')
            if names.setdefault(key, value) != value:
                raise InputError(f"--map: {key} must be given once, got {names[key]!r} and {value!r}.")
    return names


def _show_corrections(run: "Run", number: int) -> None:
    """Print the last corrections: the former result, and the one that replaced it."""
    corrections, names = run.corrections, ("outcome", "cause", *run.campaign.simulator.margins)
    for row in corrections[len(corrections) - number :].to_dict("records"):
        former, now = (
            ", ".join(
                str(value) if name in ("outcome", "cause") else f"{name} {value!r}"
                for name in names
                if (value := row[prefix + name]) != "" and value == value  # NaN differs from itself
            )
            for prefix in ("former_", "")
        )
        print(visible(f"id {row['id']}: {former} -> {now}"))


def drop(
    folder: RunFolder,
    ids: str = option(REQUIRED, "Ids of designs in flight, separated by commas."),
    code: Code = None,
) -> None:
    """Give up designs in flight; they are not proposed again."""
    numbers = [_id(text.strip()) for text in ids.split(",")]
    with opened_run(folder, write=True, code=code, simulates=False) as opened:
        number = opened.drop(numbers)
        left = opened.counts["in_flight"]
    print(f"{counted(number, 'design')} dropped; {counted(left, 'design')} in flight")


def _id(text: str) -> int:
    if not (text.isascii() and text.isdecimal() and len(text) < 19):
        raise InputError(f"--ids: must be whole numbers separated by commas, got {text!r}.")
    return int(text)


def add(
    folder: RunFolder,
    csv: Path = option(REQUIRED, "Table of simulations, with all variables; - is standard input.", Path),
    names: list[str] | None = NAMES,
    skip_invalid: bool = SKIP_INVALID,
    outside: Literal["refuse", "keep"] = option(
        "refuse", "What to do with designs outside the design space.", Literal["refuse", "keep"]
    ),
    code: Code = None,
) -> None:
    """Record simulations that `ask` did not hand out."""
    with opened_run(folder, write=True, code=code, simulates=False) as opened:
        with shown_warnings():
            new = opened.add(table_input(csv), names=_names(names), skip_invalid=skip_invalid, outside=outside)
        summary = opened.summary
    print(f"{counted(new, 'simulation')} added")
    show_unseen(summary)
