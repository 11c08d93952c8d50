"""What the classifier sees of a bearing: the paper's formulas in SI units, the sliding block, the collision model."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from activefail.errors import InputError
from activefail.learning.features import feature_map
from activefail.learning.model.latent import VariationalGP
from activefail.learning.model.training import train
from activefail.seismic.bearing import TABLE_1, Model
from activefail.seismic.bearing.collision import collision_features
from activefail.seismic.bearing.sliding import sliding_features
from activefail.seismic.features import PAPER_FEATURES, paper_features
from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace

# T_b [s], mu, D_tot [m], h_sl/D_sl, h_rim/D_sl, p [MPa], k [N/m^1.5], T_p [s], A_p [g]
DESIGN = (4.0, 0.06, 0.6, 0.8, 0.1, 50.0, 2e9, 2.0, 0.4)

# By hand, SI: D_pulse = 0.4 g (2 s / 2 pi)² = 3.924 m/s² * 0.10132118 s² = 0.39758432 m and its root 0.63054288 m^½;
# D_ratio = 0.39758432 / 0.6; T_b/T_p = 4 / 2; mu/A_p = 0.06 / 0.4; k_norm = 2e9 / (50e6 * 0.63054288).
FEATURES = (0.66264054, 2.0, 0.15, 0.8, 0.1, 63.43740)


def _permuted(order: list[int]) -> DesignSpace:
    return DesignSpace(tuple(TABLE_1.parameters[i] for i in order))


def test_the_papers_features_are_its_formulas_in_si_units() -> None:
    assert_allclose(paper_features(np.array([DESIGN]))[0], FEATURES, rtol=1e-6)


@pytest.mark.parametrize(("column", "value"), [(1, 0.0), (1, -1e9), (7, 1e-300), (7, 1e250), (6, 0.0), (2, np.nan)])
def test_a_design_whose_features_are_not_finite_or_too_far_from_the_space_is_not_learned_from(
    column: int, value: float
) -> None:
    features, X = feature_map("paper", TABLE_1), np.array([DESIGN, DESIGN])
    X[1, column] = value
    with pytest.raises(InputError, match=r"classifier.features: .* must be finite, and at most 1e\+09 standard dev"):
        train(X, np.array([0, 1], dtype=np.int8), ("safe", "failure"), features, VariationalGP())


@pytest.mark.parametrize(
    ("variable", "factor", "changes"),
    [
        ("T_b", 1.1, {"T_b/T_p": 1.1}),
        ("mu", 1.1, {"mu/A_p": 1.1}),
        ("D_tot", 1.1, {"D_ratio": 1 / 1.1}),
        ("h_sl_ratio", 1.1, {"h_sl/D_sl": 1.1}),
        ("h_rim_ratio", 1.1, {"h_rim/D_sl": 1.1}),
        ("p", 1.1, {"k_norm": 1 / 1.1}),
        ("k", 1.1, {"k_norm": 1.1}),
        ("T_p", 1.1, {"D_ratio": 1.1**2, "T_b/T_p": 1 / 1.1, "k_norm": 1 / 1.1}),
        ("A_p", 1.1, {"D_ratio": 1.1, "mu/A_p": 1 / 1.1, "k_norm": 1.1**-0.5}),
    ],
)
def test_each_variable_enters_the_papers_features_with_its_power(
    variable: str, factor: float, changes: dict[str, float]
) -> None:
    design = np.array([DESIGN])
    moved = design.copy()
    moved[0, TABLE_1.names.index(variable)] *= factor
    ratio = paper_features(moved)[0] / paper_features(design)[0]
    assert_allclose(ratio, [changes.get(name, 1.0) for name in PAPER_FEATURES], rtol=1e-12)


def test_ratios_over_decades_enter_by_their_logarithm() -> None:
    space = feature_map("paper", TABLE_1)
    low, high = space(np.array([DESIGN])), np.array([DESIGN])
    high[0, TABLE_1.names.index("k")] *= 1.5
    extra = high.copy()
    extra[0, TABLE_1.names.index("k")] *= 1.5
    column = PAPER_FEATURES.index("k_norm")
    assert_allclose((space(high) - low)[0, column], (space(extra) - space(high))[0, column], rtol=1e-12)
    assert space.logarithmic.tolist() == [True, True, True, False, False, True]


@pytest.mark.parametrize("name", ["paper", "sliding", "collision"])
def test_features_have_mean_0_and_standard_deviation_1_over_the_design_measure(name: str) -> None:
    F = feature_map(name, TABLE_1)(TABLE_1.sobol(2**13, np.random.default_rng(99)))  # type: ignore[arg-type]
    assert_allclose(F.mean(axis=0), 0.0, atol=0.01)
    assert_allclose(F.std(axis=0), 1.0, atol=0.01)


def test_the_features_of_a_design_do_not_depend_on_the_designs_beside_it() -> None:
    features, X = feature_map("paper", TABLE_1), TABLE_1.latin_hypercube(50, np.random.default_rng(3))
    assert features(X)[17:18].tobytes() == features(X[17:18]).tobytes()


@pytest.mark.parametrize("order", [[8, 7, 6, 5, 4, 3, 2, 1, 0], [4, 0, 8, 2, 6, 1, 7, 3, 5]])
def test_the_papers_features_do_not_depend_on_the_order_of_the_variables(order: list[int]) -> None:
    X = TABLE_1.latin_hypercube(64, np.random.default_rng(0))
    there, here = feature_map("paper", _permuted(order)), feature_map("paper", TABLE_1)
    assert there.names == here.names
    assert there.raw(X[:, order]).tobytes() == here.raw(X).tobytes()
    # The scaling is that of a sample of the space, whose columns are permuted with the variables.
    assert_allclose(there(X[:, order]), here(X), atol=0.02)


def test_the_papers_features_leave_out_variables_that_the_paper_has_not() -> None:
    wider = DesignSpace((Parameter("temperature", -20.0, 40.0), *TABLE_1.parameters))
    X = TABLE_1.latin_hypercube(8, np.random.default_rng(0))
    assert_allclose(
        feature_map("paper", wider).raw(np.column_stack([np.zeros(8), X])), paper_features(X), rtol=0.0, atol=0.0
    )


def test_two_maps_of_one_space_are_the_same_bits() -> None:
    X = TABLE_1.latin_hypercube(20, np.random.default_rng(1))
    assert feature_map("paper", TABLE_1)(X).tobytes() == feature_map("paper", TABLE_1)(X).tobytes()


@pytest.mark.parametrize("missing", TABLE_1.names)
def test_the_papers_features_of_a_space_that_lacks_a_variable_are_refused_by_its_name(missing: str) -> None:
    space = DesignSpace(tuple(p for p in TABLE_1.parameters if p.name != missing))
    with pytest.raises(InputError, match=f"lacks the variable '{missing}'"):
        feature_map("paper", space)


@pytest.mark.parametrize("low", [0.0, -0.1])
def test_the_papers_features_of_a_space_that_reaches_to_zero_are_refused(low: float) -> None:
    space = DesignSpace((Parameter("T_b", low, 5.5), *TABLE_1.parameters[1:]))
    with pytest.raises(InputError, match="positive"):
        feature_map("paper", space)


def test_the_sliding_blocks_features_come_after_the_variables_whatever_their_order() -> None:
    order = [4, 0, 8, 2, 6, 1, 7, 3, 5]
    X = TABLE_1.latin_hypercube(32, np.random.default_rng(0))
    features = feature_map("sliding", _permuted(order))
    assert features.names == (*_permuted(order).names, "v*", "a*")
    assert features.raw(X[:, order]).tolist() == np.column_stack([X[:, order], sliding_features(X)]).tolist()


def test_the_sliding_block_has_the_campaigns_slider_and_restitution() -> None:
    X = TABLE_1.latin_hypercube(32, np.random.default_rng(0))
    model = Model(slider_diameter=0.2, restitution_coefficient=0.4)
    assert feature_map("sliding", TABLE_1, model).raw(X)[:, 9:].tolist() == sliding_features(X, model).tolist()
    assert not np.array_equal(sliding_features(X, model), sliding_features(X))


def test_the_collisions_feature_comes_after_the_sliding_blocks() -> None:
    X = TABLE_1.latin_hypercube(32, np.random.default_rng(0))
    model = Model(slider_diameter=0.2)
    features = feature_map("collision", TABLE_1, model)
    assert features.names == (*TABLE_1.names, "v*", "a*", "m*")
    assert (
        features.raw(X)[:, 9:].tolist()
        == np.column_stack([sliding_features(X, model), collision_features(X, model)]).tolist()
    )


@pytest.mark.parametrize("name", ["sliding", "collision"])
def test_features_do_not_depend_on_how_many_cores_there_are(name, monkeypatch):
    features = feature_map(name, TABLE_1)
    X = TABLE_1.latin_hypercube(301, np.random.default_rng(6))
    answers = []
    for cores in (1, 2, 5):
        monkeypatch.setattr("os.cpu_count", lambda cores=cores: cores)
        answers.append(features(X))
    assert np.array_equal(answers[0], answers[1])
    assert np.array_equal(answers[0], answers[2])
