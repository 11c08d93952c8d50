"""`activefail explore`: a campaign as an interactive page."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from activefail.cli.common import Code, RunFolder, show_warnings
from activefail.errors import InputError


def explore(
    folder: RunFolder,
    host: Annotated[
        str, typer.Option(help="Address to serve on; other than this machine's own, a token is needed.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port; 0 for a free one.", min=0, max=65535)] = 8050,
    code: Code = None,
) -> None:
    """Serve an interactive page of what a campaign has learned, on this machine alone by default."""
    from activefail.campaign.findings import findings_of
    from activefail.campaign.learning import current_classifier
    from activefail.campaign.loop import one_thread
    from activefail.campaign.opening import open_campaign
    from activefail.explorer.answers import Answers
    from activefail.explorer.server import ExplorerServer

    with one_thread():
        with open_campaign(Path(folder), write=False, code=code) as (campaign, store):
            show_warnings(store)
            if not any((batch.results.outcome >= 0).any() for batch in store.batches):
                raise InputError(f"{folder}: has no simulations to learn from yet.")
            print("learning", file=sys.stderr, flush=True)
            classifier = current_classifier(campaign, store, write=False)
            show_warnings(store)
            findings = findings_of(folder, campaign, store, classifier)
        server = ExplorerServer(host, port, Answers(findings))
        print(f"explorer   {server.address}  (Ctrl-C ends it)", flush=True)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            print("ended", file=sys.stderr)
        finally:
            server.server_close()
