"""What a run folder says of a campaign's state, of its learning curves and of its error."""

from pathlib import Path

import numpy as np
import pytest
from campaign.stub import disc

from activefail.analyses.findings.status import read_status
from activefail.campaign.assembly import Campaign
from activefail.campaign.on_disk import create_folder
from activefail.estimates.error import verify
from activefail.estimates.probability_estimator import Estimator
from activefail.estimates.scores import learning_curve
from activefail.estimates.stored_sets import VALIDATION, stored_set
from activefail.execution.local import ThreadExecutor
from activefail.learning.model.threads import one_thread
from activefail.loop.learning import accuracy, current
from activefail.loop.running import run
from activefail.pages.report.evidence import curve_of, evidence_of
from activefail.record.run_folder import FolderStore


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    return disc(extra="validation.size = 100")


def test_a_campaign_is_running_while_a_process_writes_then_stopped_and_at_its_budget_finished(
    campaign: Campaign, tmp_path: Path
) -> None:
    folder, budget = tmp_path / "run", campaign.settings.sampling.budget
    with ThreadExecutor(1) as executor, create_folder(folder, campaign) as store:
        run(campaign, store, executor, budget - 4)
        assert read_status(folder).state == "running"
        # A reader's look takes the lock from no writer.
        with FolderStore.open(folder, write=False) as reader:
            assert len(reader.batches) == len(store.batches)
    status = read_status(folder)
    assert status.state == "stopped"
    with ThreadExecutor(1) as executor, FolderStore.open(folder, campaign.schema, write=True) as store, one_thread():
        run(campaign, store, executor, budget)
        assert store.recall(("error", store.digest)) is None
        learned = current(campaign, store, write=False)
        error = verify(Estimator(campaign, store, executor, learned.classifier, learned.iteration), 40, 0.9)
        assert evidence_of(campaign, store, learned.classifier).error == error.as_json()
        # The report says what `status` says, also of a smaller set at another confidence.
        error = verify(Estimator(campaign, store, executor, learned.classifier, learned.iteration), 20, 0.8)
        assert evidence_of(campaign, store, learned.classifier).error == error.as_json()
        designs = stored_set(store, VALIDATION)
        assert designs is not None
        last = accuracy(learned.classifier, campaign.severity, *designs)
        assert [point.simulations for point in learning_curve(store)][-1] == budget
        stages = list[str]()
        curve, _ = curve_of(campaign, store, stages.append)
        assert curve is not None
        assert (curve.scores[-1].accuracy, stages) == (last, [])
    after = read_status(folder)
    assert after.state == "finished"
    assert after.as_json()["error"] == error.as_json()
    assert dict(after.lines)["error"].startswith(error.in_words[0])
    scores = [point.score for point in after.curve]
    assert scores[-1] is not None
    assert scores[-1].accuracy == last
    assert [point.simulations for point in after.curve] == sorted({point.simulations for point in after.curve})
    # The classifiers before the second call were not learned again.
    assert after.curve[: len(status.curve)] == status.curve
    assert all(np.isfinite(one.log_score) for one in scores if one is not None)
