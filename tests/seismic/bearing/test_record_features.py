"""The cheap models' features under records: against those under pulses, their symmetries, and what they predict."""

import numpy as np
import pytest
from bearing.test_records import bearings, sampled, synthetic

from activefail.errors import InputError
from activefail.seismic.bearing import TABLE_1, Accelerogram, simulate_records
from activefail.seismic.bearing.collision import collision_features
from activefail.seismic.bearing.record_features import record_features
from activefail.seismic.bearing.sliding import sliding_features
from activefail.space.space import Array

RECORDS = [synthetic(seed, 0.4) for seed in range(8)]


def rows(n: int, seed: int = 4) -> tuple[Array, Array, Array]:
    """Bearings, their records and factors."""
    rng = np.random.default_rng(seed)
    return bearings(n, seed), rng.integers(len(RECORDS), size=n), np.exp(rng.uniform(-1.0, 1.5, n))


def test_a_sampled_pulse_has_the_features_of_the_pulse() -> None:
    X = TABLE_1.latin_hypercube(200, np.random.default_rng(1))
    pulses = [sampled(T_p, A_p, 0.002) for T_p, A_p in X[:, 7:].tolist()]
    found = record_features(X[:, :7], pulses, np.arange(200), np.ones(200))
    expected = np.hstack([sliding_features(X), collision_features(X)])
    # The tails beyond 1.5 T_p and the times of the steps differ; a stop that is just reached makes a jump of a*.
    for column, tolerance in enumerate((0.02, 0.02, 0.1)):
        difference = np.abs(found[:, column] - expected[:, column])
        assert np.median(difference) < 0.1 * tolerance
        assert np.mean(difference > tolerance) < 0.05


def test_a_factor_scales_the_record_and_its_sign_does_not_matter() -> None:
    X, which, factors = rows(60)
    found = record_features(X, RECORDS, which, factors)
    assert record_features(X, RECORDS, which, -factors).tolist() == found.tolist()
    scaled = [RECORDS[k].scaled(factor) for k, factor in zip(which, factors, strict=True)]
    again = record_features(X, scaled, np.arange(60), np.ones(60))
    assert again[:, :2] == pytest.approx(found[:, :2], rel=1e-6, abs=1e-6)
    # A collision magnifies differences of rounding.
    assert again[:, 2] == pytest.approx(found[:, 2], abs=0.02)


def test_a_row_depends_neither_on_other_rows_nor_on_the_threads() -> None:
    X, which, factors = rows(80)
    found = record_features(X, RECORDS, which, factors, threads=3)
    assert record_features(X, RECORDS, which, factors, threads=1).tolist() == found.tolist()
    last = record_features(X[-1:], RECORDS, which[-1:], factors[-1:])
    assert last[0].tolist() == found[-1].tolist()


@pytest.mark.slow
def test_they_predict_what_bearings_do_under_records() -> None:
    X, which, factors = rows(400)
    found = record_features(X, RECORDS, which, factors)
    outcome = simulate_records(X, [RECORDS[k].scaled(f) for k, f in zip(which, factors, strict=True)]).outcome
    assert min(np.bincount(outcome[outcome >= 0], minlength=3)) > 20
    assert np.mean((found[:, 0] > 0.0) == (outcome >= 1)) > 0.95
    assert np.mean((found[:, 2] > 0.0) == (outcome == 2)) > 0.95


def test_rest_after_the_record_changes_nothing() -> None:
    # A run of the collision ends once the impulse to come cannot lift the plate; rest brings none.
    X, which, factors = rows(60)
    longer = [Accelerogram(np.append(one.acceleration, np.zeros(2000)), one.dt) for one in RECORDS]
    found, after_rest = (record_features(X, motions, which, factors)[:, 2] for motions in (RECORDS, longer))
    assert np.mean(found != found[0]) > 0.3
    assert after_rest == pytest.approx(found, abs=0.05)


def test_a_bearing_that_cannot_be_built_has_no_features() -> None:
    X, which, factors = rows(3)
    X[1, 2] = 1e3
    found = record_features(X, RECORDS, which, factors)
    assert np.isnan(found[1, 2])
    assert np.isfinite(found[[0, 2]]).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda X, which, factors: (X[:, :6], which, factors), r"\(n, 7\) with the columns .*, got shape \(3, 6\)"),
        (lambda X, which, factors: (X, which + 100, factors), "which: must be from 0 to 7, got 1"),
    ],
)
def test_wrong_arguments_are_refused(change, words) -> None:  # type: ignore[no-untyped-def]
    X, which, factors = change(*rows(3))
    with pytest.raises(InputError, match=words):
        record_features(X, RECORDS, which, factors)
