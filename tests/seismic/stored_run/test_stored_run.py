"""The run folder of a finished campaign, of version 0.2.0 (format 2), stays readable, and its results stay the same.

Bits are compared where versions and processor are those that made it. Elsewhere only outcomes are.
"""

import hashlib
import shutil
from pathlib import Path

import numpy as np
import pytest
from commandline import activefail

from activefail.campaign.on_disk import open_campaign
from activefail.campaign.provenance import provenance
from activefail.loop.history import History
from activefail.loop.learning import classifier_after
from activefail.loop.saved_learning import saved_current
from activefail.record.journal import Journal
from activefail.seismic.bearing import TABLE_1, Bearing, Pulse, Tolerance, simulate, simulate_one

STORED = Path(__file__).parent / "paper"

DECIDES = ("python", "numpy", "scipy", "torch", "gpytorch", "botorch", "numba", "machine", "processor_features")
"""Of the provenance: what the bits of a campaign depend on besides its settings."""

ANSWERS = "25bf9ac94942cc3dcc493de32d996fce6a760eb954c7d1a5fa59b0fd825088dc"
"""SHA-256 of the simulator's answers, see `test_the_simulator_gives_its_answers_bit_for_bit`."""

LABELS = "0220202222020022212202200220222200100220022002222102222020200020222022022211202021000202122222020020"
"""The outcomes of its designs at a tolerance of 1e-6, where no rounding decides: the same at 1e-7."""


def has_its_bits() -> bool:
    """Whether versions and processor are those that made the folder."""
    made = next(one.event.attributes for one in Journal(STORED, write=False).entries() if one.event.kind == "software")
    return all(made[key] == provenance()[key] for key in DECIDES)


def test_every_command_reads_it_without_a_warning(tmp_path: Path) -> None:
    run, table, designs = tmp_path / "run", tmp_path / "all.csv", tmp_path / "designs.csv"
    shutil.copytree(STORED, run)
    said = activefail("status", run)
    assert (said.code, said.err) == (0, "")
    assert "done       40 of 40 simulations, iteration 4" in said.out
    said = activefail("export", run, "--csv", table)
    assert (said.code, said.err) == (0, "")
    rows = [line.split(",")[3:12] for line in table.read_text().splitlines()]
    designs.write_text("\n".join(",".join(row) for row in rows) + "\n")
    said = activefail("predict", run, "--csv", designs, "--out", tmp_path / "predictions.csv")
    assert (said.code, said.err) == (0, "")


def test_its_saved_state_is_what_is_learned_from_its_simulations() -> None:
    with open_campaign(STORED, write=False) as (campaign, store):
        assert store.latest_state() is not None
        F = campaign.features(campaign.space.latin_hypercube(200, np.random.default_rng(0)))
        saved, again = saved_current(campaign, store), classifier_after(campaign, History.of(store.batches))
        for then, now in zip(saved.latents, again.latents, strict=True):
            # Each objective is maximised to 1e-3 nat.
            assert now.moments(F).probability == pytest.approx(then.moments(F).probability, abs=1e-3)


def test_the_simulator_gives_its_labels() -> None:
    with open_campaign(STORED, write=False) as (campaign, store):
        for batch in store.batches:
            again = simulate(campaign.space.table(batch.designs, TABLE_1.names), campaign.settings.bearing.model())
            assert np.array_equal(again.outcome, batch.results.outcome)
            if has_its_bits():
                assert np.array_equal(again.columns, batch.results.margins, equal_nan=True)


def test_the_simulator_gives_its_answers_bit_for_bit() -> None:
    X, digest = TABLE_1.latin_hypercube(1000, np.random.default_rng(7)), hashlib.sha256()
    for rows, tolerance in ((1000, Tolerance()), (100, Tolerance(relative=1e-6)), (100, Tolerance(most_steps=300))):
        answers = simulate(X[:rows], tolerance=tolerance)
        for column in (answers.outcome, answers.cause, answers.columns):
            digest.update(column.tobytes())
        if tolerance.relative == 1e-6:
            assert "".join(map(str, answers.outcome)) == LABELS
    for row in X[:40]:
        response = simulate_one(Bearing.from_table(*row[:7]), Pulse.from_table(*row[7:]), to_the_end=True)
        for history in (response.t, response.q, response.v, response.a):
            digest.update(history.tobytes())
    assert digest.hexdigest() == ANSWERS or not has_its_bits()
