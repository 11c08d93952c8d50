"""A campaign to explore, with a hostile name."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from patience import until
from report.test_report import ran, settings

from activefail.campaign.on_disk import open_campaign
from activefail.explorer.answers import Answers
from activefail.explorer.server import ExplorerServer
from activefail.findings.results import Findings, findings_of
from activefail.loop.learning import current_classifier
from activefail.surrogate.threads import one_thread


@pytest.fixture(scope="session")
def findings(tmp_path_factory: pytest.TempPathFactory) -> Findings:
    folder = tmp_path_factory.mktemp("explore") / "run"
    ran(folder, settings(budget=40))
    with open_campaign(folder, write=False) as (campaign, store), one_thread():
        return findings_of(folder, campaign, store, current_classifier(campaign, store, write=False))


@pytest.fixture(scope="session")
def answers(findings: Findings) -> Answers:
    return Answers(findings)


@contextmanager
def served(answers: Answers, host: str = "127.0.0.1") -> Iterator[ExplorerServer]:
    """A server of these answers on a free port, in a thread of its own."""
    with ExplorerServer(host, 0, answers) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()
            # Who is still being answered would compete for the classifier with the next test.
            until(lambda: not server.connections, "the end of all connections")
