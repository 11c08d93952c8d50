"""The commands of the analyses, made from their requests: parse, ask, print."""

import inspect
import sys
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

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
from activefail.cli.options import Parameters, parameters_of, sign
from activefail.display import progress_bar
from activefail.errors import InputError
from activefail.files import writing_to
from activefail.progress import uncounted
from activefail.request import Option, Request, options
from activefail.visible import visible

if TYPE_CHECKING:
    from activefail.explorer.jobs import Jobs
    from activefail.explorer.pages import Site
    from activefail.report.evidence import Curve
    from activefail.run import Run
    from activefail.surrogate.classifier import Classifier


def command_of(name: str, request: type[Request[Any]]) -> Callable[..., None]:
    """The command that asks a request of a run folder and prints the findings."""

    def command(
        context: typer.Context, folder: Path | None, as_json: bool, code: Path | None = None, **words: Any
    ) -> None:
        csv, out = words.pop("csv", None), words.pop("out", None)
        check_out(out)
        check_table("--csv", csv)
        if as_json and csv in STANDARD:
            raise InputError("--json: cannot be combined with `--csv -`; both write to standard output.")
        given = {word for word in words if getattr(context.get_parameter_source(word), "name", "") != "DEFAULT"}
        values = {one.name: _value(one.name, words, of, out, one.name in given) for one, of in options(request)}
        run_or_none = (
            nullcontext() if folder is None else opened_run(folder, write=request.is_written(words), code=code)
        )
        with run_or_none as run:
            with progress_bar(request.counts) if request.counts else nullcontext(uncounted) as begin:
                asked = request(**values, begin=begin, stage=show_stage)
                findings = asked.answer(run)
            summary = None if run is None else run.summary
        if csv is not None:
            with table_output("--csv", csv) as target:
                asked.write_table(findings, target)
        written = []
        if out is not None:
            with writing_to(out):
                written = asked.write_pages(findings, run, out)
        if summary is not None:
            show_unseen(summary)
        if as_json:
            print_json(findings.as_json())
        elif csv not in STANDARD:
            print("\n".join(map(visible, findings.lines)))
            if csv is not None:
                print(f"table      {name_of(csv)}")
            if written:
                print(f"written    in {visible(str(out))}: {', '.join(path.name for path in written)}")
        if findings.exit_code:
            raise typer.Exit(findings.exit_code)

    command.__name__, command.__doc__ = name, request.__doc__
    sign(command, _parameters(request))
    return command


def _value(name: str, words: dict[str, Any], of: Option, out: Path | None, is_given: bool) -> Any:
    """The value of an option, from the words on the command line; None if an option of one way is not given."""
    if of.parts:
        return of.value(words)
    if of.with_out and of.kind is Path:
        return out
    word = words[name]
    if of.with_out and word and is_given and out is None:
        raise InputError(f"--{name}: requires --out.")
    if of.is_of_one_way and not is_given:
        return (of.with_out and out is not None and words[of.bars] is None) or None
    if of.parse is None:
        return word
    return of.default if word is None else of.parse(word)


def _parameters(request: type[Request[Any]]) -> Parameters:
    """The parameters of the command of a request."""
    parameters: Parameters = {"context": (typer.Context, inspect.Parameter.empty)}
    parameters |= {} if request.of_run else {"folder": (RunFolder, inspect.Parameter.empty)}
    for one, of in options(request):
        # `--out` names the folder.
        if not (of.with_out and of.kind is Path):
            parameters |= parameters_of(one.name, of)
    if request.of_run is not None:
        parameters |= parameters_of("folder", request.of_run)
    parameters["as_json"] = AsJson, False
    for name, help in (("csv", request.table), ("out", request.pages)):
        if help:
            parameters |= parameters_of(name, Option(help, Path))
    return parameters | {"code": (Code, None)}


def site_of(folder: Path, jobs: "Jobs", code: Path | None = None, home: str = "") -> "Site":
    """The explorer's site of a run folder."""
    from activefail.explorer.campaign import Slow
    from activefail.explorer.site import CampaignSite
    from activefail.findings.results import findings_of
    from activefail.surrogate.threads import one_thread_from_now_on

    with opened_run(folder, code=code) as opened:
        # What is shown at first needs predictions alone.
        classifier = cast("Classifier", opened._predicting())
        findings = findings_of(opened.folder, opened.campaign, opened.store, classifier)
        show_unseen(opened.summary)

    def learning() -> "Run":
        one_thread_from_now_on()
        return opened

    def curve() -> "Curve | None":
        from activefail.report.evidence import curve_of

        return curve_of(learning().campaign, opened.store)[0]

    slow = Slow(lambda: learning().classifier, lambda: learning().failure(), curve)
    return CampaignSite(findings, slow, jobs, home)


def explore(
    folder: Annotated[
        Path,
        typer.Argument(help="Run folder of a campaign, or a folder of run folders.", metavar="DIR", show_default=False),
    ],
    host: Annotated[
        str, typer.Option(help="Address to listen on; visitors from other machines always need the token.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port; 0 for a free one.", min=0, max=65535)] = 8050,
    no_token: Annotated[
        bool, typer.Option("--no-token", help="Let every user of this machine read the page without the token.")
    ] = False,
    code: Code = None,
) -> None:
    """Serve an interactive page of a campaign, or of all campaigns in a folder of run folders.

    By default only this machine can connect, and only with the token in the printed address.
    """
    from activefail.explorer.jobs import Jobs
    from activefail.explorer.runs import Runs, run_folders
    from activefail.explorer.server import ExplorerServer
    from activefail.surrogate.threads import one_thread_of_blas

    with one_thread_of_blas(), Jobs() as jobs:
        if run_folders(folder):
            if code is not None:
                raise InputError(f"--code: requires one run folder, but {folder} holds several.")
            site: Site = Runs(folder, lambda one: site_of(one, jobs, home="../../"))
        else:
            site = site_of(folder, jobs, code)
        with ExplorerServer(host, port, site, not no_token) as server:
            print(f"explorer   {server.address}  (Ctrl-C to quit)", flush=True)
            try:
                server.serve_forever()
            except KeyboardInterrupt:
                print("stopped", file=sys.stderr)
