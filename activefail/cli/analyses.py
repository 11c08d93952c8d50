"""The commands of the analyses, made from their requests: parse, ask, print."""

import inspect
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer

from activefail.cli.common import (
    STANDARD,
    AsJson,
    Code,
    RunFolder,
    check_out,
    check_table,
    name_of,
    opened_run,
    print_json,
    show_stage,
    show_unseen,
    table_output,
)
from activefail.display import progress_bar
from activefail.errors import InputError
from activefail.files import writing_to
from activefail.progress import uncounted
from activefail.request import REQUIRED, Option, Request, options
from activefail.visible import visible


def command_of(name: str, request: type[Request[Any]]) -> Callable[..., None]:
    """The command that asks a request of a run folder and prints the findings."""

    def command(folder: Path, as_json: bool, code: Path | None, **words: Any) -> None:
        csv, out = words.pop("csv", None), words.pop("out", None)
        check_out(out)
        check_table("--csv", csv)
        if as_json and csv == STANDARD:
            raise InputError("--json: cannot be combined with `--csv -`; both write to standard output.")
        values = {one.name: _value(words[one.name], of, out, one.default) for one, of in options(request)}
        with opened_run(folder, write=request.records, code=code) as run:
            with progress_bar(request.counts) if request.counts else nullcontext(uncounted) as begin:
                asked = request(**values, begin=begin, stage=show_stage)
                findings = asked.answer(run)
            summary = run.summary
        if csv is not None:
            with table_output("--csv", csv) as target:
                asked.write_table(findings, target)
        written = []
        if out is not None:
            with writing_to(out):
                written = asked.write_pages(findings, run, out)
        show_unseen(summary)
        if as_json:
            print_json(findings.as_json())
        elif csv != STANDARD:
            print("\n".join(map(visible, findings.lines)))
            if csv is not None:
                print(f"table      {name_of(csv)}")
            if written:
                print(f"written    in {visible(str(out))}: {', '.join(path.name for path in written)}")
        if findings.exit_code:
            raise typer.Exit(findings.exit_code)

    command.__name__, command.__doc__ = name, request.__doc__
    _declare(command, request)
    return command


def _value(word: Any, of: Option, out: Path | None, default: Any) -> Any:
    """The value of an option, from the word on the command line or its default."""
    if of.with_out and out is None:
        return False
    if of.parse is None:
        return word
    return default if word is None else of.parse(word)


def _declare(command: Callable[..., None], request: type[Request[Any]]) -> None:
    """Give a command the signature from which typer makes its options."""
    parameters: dict[str, tuple[Any, Any]] = {"folder": (RunFolder, inspect.Parameter.empty)}
    for one, of in options(request):
        required = one.default is REQUIRED
        default = None if of.parse is not None or required else of.with_out or one.default
        names = of.names or ()
        shown = typer.Option(
            *names, help=of.help, min=of.low, max=of.high, metavar=of.metavar, show_default=default not in (None, "")
        )
        kind = of.kind if required or default is not None else of.kind | None
        parameters[one.name] = Annotated[kind, shown], inspect.Parameter.empty if required else default
    parameters["as_json"] = AsJson, False
    for name, help in (("csv", request.table), ("out", request.pages)):
        if help:
            parameters[name] = Annotated[Path | None, typer.Option(help=help, show_default=False)], None
    parameters["code"] = Code, None
    kind = inspect.Parameter.KEYWORD_ONLY
    command.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [inspect.Parameter(name, kind, default=default, annotation=of) for name, (of, default) in parameters.items()]
    )
    command.__annotations__ = {name: of for name, (of, _) in parameters.items()} | {"return": None}
