"""The stop rule for a probability in campaigns without batches: its check waits for all that is in flight."""

from pathlib import Path

import pytest
from loop.test_asynchronous import Arbitrary, first_events, kept
from loop.test_probability_rule import PROBABILITY, FourBranch, campaign_on

from activefail.campaign.assembly import Campaign
from activefail.loop.history import History
from activefail.loop.in_flight import HandedOut
from activefail.loop.learning import current
from activefail.loop.running import run
from activefail.record.batch import ACTIVE, CHECK, INITIAL
from activefail.record.memory import MemoryStore
from activefail.record.run_folder import FolderStore
from activefail.record.store import Store

FLIGHT, BUDGET = 6, 120


def take(campaign: Campaign, store: Store, **options: bool) -> Store:
    run(campaign, store, Arbitrary(), BUDGET, **options)
    return store


@pytest.fixture(scope="module")
def ended() -> tuple[Campaign, Store]:
    campaign = campaign_on(FourBranch(), seed=2, sampling__batch=FLIGHT, sampling__asynchronous=True)
    return campaign, take(campaign, MemoryStore(campaign.schema))


def test_it_ends_by_itself_after_a_check_that_contradicted_nothing(ended: tuple[Campaign, Store]) -> None:
    campaign, store = ended
    history = History.of(store.batches)
    assert len(history) < BUDGET
    assert set(history.origin.tolist()) == {INITIAL, ACTIVE, CHECK}
    assert (history.origin == CHECK).sum() >= 4 + 2 * 2
    learned = current(campaign, store, write=False)
    assert learned.looks.is_known
    assert learned.looks.probability == pytest.approx(PROBABILITY, rel=0.25)
    assert len(HandedOut.of(store).in_flight) == 0


def test_a_check_is_learned_from_once_all_its_results_have_arrived(ended: tuple[Campaign, Store]) -> None:
    _, store = ended
    history, asked = History.of(store.batches), store.asked
    checks = [history.iteration[history.origin == CHECK], asked.learned[asked.origin == CHECK]]
    assert (checks[0] == checks[1] + 1).all()
    # Its results came in parts.
    assert sum((batch.origin == CHECK).any() for batch in store.batches) > 1


def test_resumed_after_its_end_it_simulates_nothing_more(ended: tuple[Campaign, Store]) -> None:
    campaign, store = ended
    before = kept(store)
    assert kept(take(campaign, store)) == before


@pytest.mark.slow
def test_killed_within_its_check_and_right_after_it_it_continues_to_the_same_campaign(
    ended: tuple[Campaign, Store], tmp_path: Path
) -> None:
    campaign, whole = ended
    with FolderStore.create(tmp_path / "run", campaign.settings.text(), campaign.schema) as store:
        take(campaign, store)
        assert kept(store) == kept(whole)
    journals = first_events(tmp_path / "run" / "journal")
    for journal in (journals[-1], journals[-2], journals[-4]):
        (tmp_path / "run" / "journal").write_bytes(journal)
        (tmp_path / "run" / "checkpoint.h5").unlink()
        with FolderStore.open(tmp_path / "run", campaign.schema, write=True) as store:
            take(campaign, store)
            assert kept(store) == kept(whole)


def test_more_simulations_than_the_check_meet_the_rule_no_longer(ended: tuple[Campaign, Store]) -> None:
    campaign, store = ended
    run(campaign, store, Arbitrary(), len(History.of(store.batches)) + 1, use_stop_rule=False)
    assert not current(campaign, store, write=False).looks.is_known
