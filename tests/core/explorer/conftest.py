"""A campaign to explore, with a hostile name."""

import socket
import socketserver
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from pounding import NAMES
from report.browser import browser
from report.test_report import ran, settings

from activefail.analyses.findings.results import Findings, findings_of
from activefail.campaign.assembly import Campaign
from activefail.campaign.on_disk import open_campaign
from activefail.learning.model.threads import one_thread
from activefail.loop.learning import current
from activefail.pages.explorer.campaign import OneDesign, Slow
from activefail.pages.explorer.jobs import Jobs
from activefail.pages.explorer.pages import Site
from activefail.pages.explorer.server import ExplorerServer
from activefail.pages.explorer.site import CampaignSite
from activefail.record.run_folder import FolderStore


@pytest.fixture(scope="session")
def findings(tmp_path_factory: pytest.TempPathFactory) -> Findings:
    folder = tmp_path_factory.mktemp("explore") / "run"
    ran(folder, settings(budget=40))
    with open_campaign(folder, write=False) as (campaign, store), one_thread():
        return findings_of(folder, campaign, store, current(campaign, store, write=False).classifier)


@pytest.fixture(scope="session")
def one(findings: Findings) -> OneDesign:
    return site_of(findings).one


def findings_in(campaign: Campaign, folder: Path) -> Findings:
    """The findings of a campaign that is taken to its budget in a folder."""
    ran(folder, campaign)
    with FolderStore.open(folder, campaign.schema, write=False) as store, one_thread():
        return findings_of(folder, campaign, store, current(campaign, store, write=False).classifier)


@pytest.fixture(scope="module")
def server(findings: Findings) -> Iterator[ExplorerServer]:
    with served(site_of(findings)) as running:
        yield running


@pytest.fixture(scope="module")
def address(server: ExplorerServer) -> str:
    return server.address


@pytest.fixture(scope="module")
def driver() -> Iterator[Any]:
    with browser() as driver:
        yield driver


class Visitor:
    """A visitor with a browser."""

    def __init__(self, driver: Any) -> None:
        self.driver = driver

    def one(self, css: str) -> Any:
        return self.driver.find_element("css selector", css)


def site_of(findings: Findings, home: str = "", jobs: Jobs | None = None, failure: Any = None) -> CampaignSite:
    """The site of a campaign that says nothing of a probability and has no learning curve."""
    slow = Slow(lambda: findings.classifier, failure or (lambda: None), lambda: None)
    return CampaignSite(findings, slow, jobs or Jobs(), home)


def form(X: list[float], names: tuple[str, ...] = NAMES, **values: object) -> dict[str, object]:
    """The form of the page of one design, as a browser sends it."""
    return dict(zip(names, map(str, X), strict=True)) | values


def there(visitor: Visitor, css: str, text: str = "") -> bool:
    """Whether a page has such an element, with this text."""
    script = "return [...document.querySelectorAll(arguments[0])].map((it) => it.innerText ?? it.textContent)"
    return any(text in one for one in visitor.driver.execute_script(script, css))


@contextmanager
def served(site: Site, host: str = "127.0.0.1", needs_token: bool = False) -> Iterator[ExplorerServer]:
    """A server of this site on a free port, in a thread of its own."""
    with ExplorerServer(host, 0, site, needs_token) as server:
        # Who is still being answered would compete for the classifier with the next test.
        server.daemon_threads = False
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


@contextmanager
def tunnel(port: int, prefix: str = "") -> Iterator[int]:
    """Another port that leads to this one, as `ssh -L` does; a proxy with a path before the server's, if it has one."""

    # Either side may hang up.
    class Forwarded(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            with suppress(OSError), socket.create_connection(("127.0.0.1", port)) as server:
                back = threading.Thread(target=copied, args=(server, self.request), daemon=True)
                back.start()
                while data := self.request.recv(65536):
                    server.sendall(data.replace(f" {prefix}/".encode(), b" /", 1))
                server.shutdown(socket.SHUT_WR)
                back.join()

    def copied(source: socket.socket, target: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(65536):
                target.sendall(data)

    class Tunnel(socketserver.ThreadingTCPServer):
        daemon_threads = True

    with Tunnel(("127.0.0.1", 0), Forwarded) as forwarding:
        threading.Thread(target=forwarding.serve_forever, daemon=True).start()
        try:
            yield forwarding.server_address[1]
        finally:
            forwarding.shutdown()
