"""A campaign on bearings that is killed."""

import time
from pathlib import Path

import numpy as np
import pytest
from loop.test_batches import kill_after, learned, recorded, take

from activefail.campaign.assembly import Campaign
from activefail.campaign.on_disk import open_campaign
from activefail.campaign.settings import parse_settings

# With a budget that is never reached: the killer may come late.
BEARING = "seed = 11\nsampling = { initial = 40, budget = 5000, batch = 5 }\n"


@pytest.mark.faults
def test_a_bearing_campaign_killed_twice_and_resumed_is_the_uninterrupted_one_bit_for_bit(tmp_path: Path) -> None:
    (tmp_path / "bearing.toml").write_text(BEARING)
    folder = tmp_path / "run"
    delays = np.random.default_rng(time.time_ns()).uniform(0.0, 0.2, 2).tolist()
    begin = ["run", str(tmp_path / "bearing.toml"), "--out", str(folder), "--workers", "2"]
    kill_after(begin, folder, 2, delays[0] / 10.0)
    kill_after(["resume", str(folder), "--workers", "1"], folder, 9, delays[1])

    campaign = Campaign.of(parse_settings(BEARING, "bearing"))
    with open_campaign(folder, write=True) as (reopened, store):
        assert len(store.batches) >= 9
        budget = max(120, 5 * len(store.batches) + 5)
        straight = take(campaign, budget=budget, workers=2)
        take(reopened, store, budget=budget)
        assert recorded(store) == recorded(straight)
        assert learned(store) == learned(straight)
