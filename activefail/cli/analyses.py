"""The commands of the analyses, made from their declarations: parse, ask, print."""

import inspect
import sys
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

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
from activefail.errors import InputError
from activefail.run.analysis import REQUIRED, Option, declared, option
from activefail.session.display import progress_bar
from activefail.text.files import writing_to
from activefail.text.progress import uncounted
from activefail.visible import visible

if TYPE_CHECKING:
    from activefail.learning.model.classifier import Classifier
    from activefail.pages.explorer.jobs import Jobs
    from activefail.pages.explorer.pages import Site
    from activefail.pages.report.evidence import Curve
    from activefail.run.run import Run


def command_of(function: Callable[..., Any]) -> dict[Callable[..., None], str]:
    """The command of an analysis, with its example: it opens the run folder, asks, prints and writes the findings."""
    asks = declared(function)
    # It is an option of an analysis that has an answer without it.
    folder_option = asks.options.get("run")

    def command(context: typer.Context, as_json: bool, code: Path | None = None, **words: Any) -> None:
        folder, csv, out = words.pop("run"), words.pop("csv", None), words.pop("out", None)
        check_out(out)
        check_table("--csv", csv)
        if as_json and csv in STANDARD:
            raise InputError("--json: cannot be combined with `--csv -`; both write to standard output.")
        given = {word for word in words if getattr(context.get_parameter_source(word), "name", "") != "DEFAULT"}
        values = {
            name: _value(name, words, of, out, name in given)
            for name, of in asks.options.items()
            if name != "run" and (of.with_out or given & set(of.parts or (name,)))
        }
        asks.check(values, in_words=True)
        writes = asks.writes(words) if callable(asks.writes) else asks.writes
        with nullcontext() if folder is None else opened_run(folder, write=writes, code=code) as run:
            with progress_bar(asks.counts) if asks.counts else nullcontext(uncounted) as begin:
                heard = {name: one for name, one in {"stage": show_stage, "begin": begin}.items() if name in takes}
                findings = function(run=run, **values, **heard)
            summary = None if run is None else run.summary
        if csv is not None:
            with table_output("--csv", csv) as target:
                findings.write_table(target)
        written = []
        if out is not None:
            with writing_to(out):
                written = asks.write_pages(findings, run, out)
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

    takes = inspect.signature(function).parameters
    parameters: Parameters = {"context": (typer.Context, inspect.Parameter.empty)}
    parameters |= {} if folder_option else {"run": (RunFolder, inspect.Parameter.empty)}
    for name, of in asks.options.items():
        # `--out` names the folder.
        if not (of.with_out and of.kind is Path):
            parameters |= parameters_of(name, of)
    parameters["as_json"] = AsJson, False
    for name, help in (("csv", asks.table), ("out", asks.pages)):
        if help:
            parameters |= parameters_of(name, Option(None, help, Path))
    command.__name__, command.__doc__ = function.__name__, asks.doc
    sign(command, parameters | {"code": (Code, None)})
    return {command: asks.example}


def _value(name: str, words: dict[str, Any], of: Option, out: Path | None, is_given: bool) -> Any:
    """The value of an option, from the words on the command line."""
    if of.parts:
        return of.value(words)
    if of.with_out and of.kind is Path:
        return out
    word = words[name]
    if of.with_out:  # on with --out, unless another option bars it
        if word and is_given and out is None:
            raise InputError(f"--{name}: requires --out.")
        return word and out is not None and (is_given or words[of.bars] is None)
    if of.parse is None:
        return word
    if word is None:
        return of.default
    try:
        return of.parse(word)
    except ValueError as error:
        raise InputError(f"{of.words(name)}: {error}, got {word!r}.") from None


def site_of(folder: Path, jobs: "Jobs", code: Path | None = None, home: str = "") -> "Site":
    """The explorer's site of a run folder."""
    from activefail.analyses.findings.results import findings_of
    from activefail.learning.model.threads import one_thread_from_now_on
    from activefail.pages.explorer.campaign import Slow
    from activefail.pages.explorer.site import CampaignSite
    from activefail.session.session import predicting

    with opened_run(folder, code=code) as opened:
        # What is shown at first needs predictions alone.
        classifier = cast("Classifier", predicting(opened))
        findings = findings_of(opened.folder, opened.campaign, opened.store, classifier)
        show_unseen(opened.summary)

    def learning() -> "Run":
        one_thread_from_now_on()
        return opened

    def curve() -> "Curve | None":
        from activefail.pages.report.evidence import curve_of

        return curve_of(learning().campaign, opened.store)[0]

    slow = Slow(lambda: learning().classifier, lambda: learning().failure(), curve)
    return CampaignSite(findings, slow, jobs, home)


def explore(
    folder: Path = option(
        REQUIRED, "Run folder of a campaign, or a folder of run folders.", Path, is_argument=True, metavar="DIR"
    ),
    host: str = option("127.0.0.1", "Address to listen on; visitors from other machines always need the token."),
    port: int = option(8050, "Port; 0 for a free one.", low=0, high=65535),
    no_token: bool = option(False, "Let every user of this machine read the page without the token."),
    code: Code = None,
) -> None:
    """Serve an interactive page of a campaign, or of all campaigns in a folder of run folders.

    By default only this machine can connect, and only with the token in the printed address.
    """
    from activefail.learning.model.threads import one_thread_of_blas
    from activefail.pages.explorer.jobs import Jobs
    from activefail.pages.explorer.runs import Runs, run_folders
    from activefail.pages.explorer.server import ExplorerServer

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
