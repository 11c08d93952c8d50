"""Run folders of an earlier version: they open, and an interrupted campaign resumes to the bits of the finished one.

Each campaign is there twice: `finished`, and `interrupted` by kill -9 after two batches that were chosen by learning.
Version 0.1.0 made both on one machine. Bits are compared where versions and processor are those of that machine.
Elsewhere only what does not depend on them is: what was recorded, the labels, and predictions to three digits.
"""

import hashlib
import shutil
from pathlib import Path

import numpy as np
import pytest
from commandline import activefail

from activefail.bearing import TABLE_1, Bearing, Pulse, Tolerance, simulate, simulate_one
from activefail.campaign.on_disk import open_campaign
from activefail.campaign.provenance import provenance
from activefail.loop.learning import classifier_after, saved_current

HERE = Path(__file__).parent
CAMPAIGNS = ("paper", "bearing", "custom")

DECIDES = ("python", "numpy", "scipy", "torch", "gpytorch", "botorch", "numba", "machine", "processor_features")
"""Of the provenance: what the bits of a campaign depend on besides its settings."""


ANSWERS = "25bf9ac94942cc3dcc493de32d996fce6a760eb954c7d1a5fa59b0fd825088dc"
"""SHA-256 of the simulator's answers, see `test_the_simulator_gives_the_answers_of_the_earlier_version_bit_for_bit`."""


LABELS = "0220202222020022212202200220222200100220022002222102222020200020222022022211202021000202122222020020"
"""The outcomes of its designs at a tolerance of 1e-6, where no rounding decides: the same at 1e-7."""


def code(name):
    return ("--code", HERE) if name == "custom" else ()


@pytest.fixture
def folder(tmp_path):
    """Copies an old run folder to where it may be changed."""
    return lambda state, name: Path(shutil.copytree(HERE / state / name, tmp_path / state / name))


def has_its_bits(store):
    """Whether versions and processor are those that made a run folder."""
    made, here = store.segments[-1].provenance, provenance()
    return all(made[key] == here[key] for key in DECIDES)


def assert_same_bits(one, other):
    """The same designs, and the same results."""
    assert np.array_equal(one.designs, other.designs)
    assert np.array_equal(one.results.outcome, other.results.outcome)
    assert np.array_equal(one.results.margins, other.results.margins, equal_nan=True)


@pytest.mark.parametrize("state", ["finished", "interrupted"])
@pytest.mark.parametrize("name", CAMPAIGNS)
def test_every_command_reads_an_old_run_folder_without_a_warning(state, name, folder, tmp_path):
    run = folder(state, name)
    table = tmp_path / "simulations.csv"
    done = 40 if state == "finished" else len(list((run / "segments").glob("*.h5"))) * 5
    said = activefail("status", run)
    assert (said.code, said.err) == (0, "")
    assert f"done       {done} of 40 simulations" in said.out
    said = activefail("export", run, "--csv", table)
    assert (said.code, said.err) == (0, "")
    assert len(table.read_text().splitlines()) == done + 1
    columns = tmp_path / "designs.csv"
    designs = {"paper": 9, "bearing": 9, "custom": 3}[name]
    rows = [line.split(",")[3 : 3 + designs] for line in table.read_text().splitlines()]
    columns.write_text("\n".join(",".join(row) for row in rows) + "\n")
    said = activefail("predict", run, "--csv", columns, "--out", tmp_path / "predictions.csv")
    assert (said.code, said.err) == (0, "")


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_an_old_interrupted_campaign_resumes_to_the_bits_of_the_finished_one(name, folder):
    run, finished = folder("interrupted", name), folder("finished", name)
    recorded = len(list((run / "segments").glob("*.h5")))
    said = activefail("resume", run, *code(name))
    assert said.code == 0
    with (
        open_campaign(run, write=False, code=HERE) as (_, resumed),
        open_campaign(finished, write=False, code=HERE) as (campaign, expected),
    ):
        has_all_bits = has_its_bits(expected)
        assert sum(len(batch) for batch in resumed.batches) == 40
        for number, (one, other) in enumerate(zip(resumed.batches, expected.batches, strict=True)):
            assert one.iteration == other.iteration
            assert np.array_equal(one.origin, other.origin)
            if has_all_bits or number < recorded:
                assert_same_bits(one, other)
        (last, learned), (same, wanted) = resumed.latest_state(), expected.latest_state()
        assert last == same
        # Version 0.1.0 did not save the scaling of the features.
        assert learned.keys() == wanted.keys() | {"features/center", "features/spread"}
        for key in wanted if has_all_bits else ():
            assert np.array_equal(learned[key], wanted[key]), key
        X = campaign.space.latin_hypercube(200, np.random.default_rng(0))
        saved, again = saved_current(campaign, expected), classifier_after(campaign, expected.batches)
        F = campaign.features(X)
        for then, now in zip(saved.latents, again.latents, strict=True):
            # Each objective is maximised to 1e-3 nat.
            assert now.moments(F).probability == pytest.approx(then.moments(F).probability, abs=1e-3)


def test_sets_of_an_old_run_folder_are_read_and_not_simulated_again(folder):
    run = folder("finished", "bearing")
    with open_campaign(run, write=False) as (_, store):
        assert store.set_names() == ["validation-0", "verification-4-20-0"]
        for name in store.set_names():
            X, results = store.read_set(name)
            assert X.shape == (20, 9)
            assert len(results) == 20
    before = {path.name: path.read_bytes() for path in (run / "sets").iterdir()}
    said = activefail("verify", run, "--simulations", "20")
    assert said.code == 0
    assert "20 fresh simulations" in said.out
    assert {path.name: path.read_bytes() for path in (run / "sets").iterdir()} == before


@pytest.mark.parametrize("name", ["paper", "bearing"])
def test_the_simulator_gives_the_labels_of_the_earlier_version(name):
    with open_campaign(HERE / "finished" / name, write=False) as (campaign, store):
        for batch in store.batches:
            again = simulate(campaign.space.table(batch.designs, TABLE_1.names), campaign.settings.bearing.model())
            assert np.array_equal(again.outcome, batch.results.outcome)
            if has_its_bits(store):
                assert np.array_equal(again.columns, batch.results.margins, equal_nan=True)


def test_the_simulator_gives_the_answers_of_the_earlier_version_bit_for_bit():
    with open_campaign(HERE / "finished" / "bearing", write=False) as (_, store):
        has_all_bits = has_its_bits(store)
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
    assert digest.hexdigest() == ANSWERS or not has_all_bits
