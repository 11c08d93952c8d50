"""`activefail explore`: a campaign as an interactive page."""

import sys
from typing import Annotated

import typer

from activefail.cli.common import Code, RunFolder, opened_run, show_stage, show_unseen, show_warnings


def explore(
    folder: RunFolder,
    host: Annotated[
        str, typer.Option(help="Address to listen on; visitors from other machines need a token.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port; 0 for a free one.", min=0, max=65535)] = 8050,
    code: Code = None,
) -> None:
    """Serve an interactive page of a campaign.

    By default only this machine can connect.
    """
    from activefail.explorer.answers import Answers
    from activefail.explorer.server import ExplorerServer
    from activefail.surrogate.threads import one_thread

    with one_thread():
        with opened_run(folder, code=code) as opened:
            opened.learn(show_stage)
            findings, failure = opened.findings, opened.failure(show_stage)
            show_warnings(opened.store.new_warnings())
            show_unseen(opened.summary)
        server = ExplorerServer(host, port, Answers(findings, failure))
        print(f"explorer   {server.address}  (Ctrl-C to quit)", flush=True)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            print("stopped", file=sys.stderr)
        finally:
            server.server_close()
