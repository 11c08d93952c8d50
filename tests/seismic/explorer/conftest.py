"""A campaign on bearings to explore."""

import pytest
from explorer.conftest import address, driver, one, server
from report.bearings import settings
from report.test_report import ran

from activefail.analyses.findings.results import Findings, findings_of
from activefail.campaign.on_disk import open_campaign
from activefail.learning.model.threads import one_thread
from activefail.loop.learning import current

__all__ = ["address", "driver", "findings", "one", "server"]


@pytest.fixture(scope="session")
def findings(tmp_path_factory: pytest.TempPathFactory) -> Findings:
    """The findings of a small campaign over the paper's variables."""
    folder = tmp_path_factory.mktemp("explore") / "run"
    ran(folder, settings(budget=40))
    with open_campaign(folder, write=False) as (campaign, store), one_thread():
        return findings_of(folder, campaign, store, current(campaign, store, write=False).classifier)
