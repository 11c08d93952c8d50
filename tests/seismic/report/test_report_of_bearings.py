"""The report of a campaign on the bearing."""

import re
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cases import some
from report.bearings import settings
from report.pictures import slow_pictures_empty
from report.test_report import TINY, Page, made, ran, self_contained

from activefail.analyses.findings import quantities
from activefail.analyses.findings.results import findings_of
from activefail.campaign.assembly import Campaign
from activefail.campaign.on_disk import open_campaign
from activefail.campaign.settings import parse_settings
from activefail.learning.model.threads import one_thread
from activefail.loop.learning import current
from activefail.pages.report import evidence, page
from activefail.seismic.bearing.design import TABLE_1
from activefail.seismic.features import paper_features
from activefail.seismic.figures import feature_planes
from activefail.seismic.quantities import VARIABLES
from activefail.space.shares import significant
from activefail.text.quantities import quantity


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small campaign over the paper's variables, with a hostile name and a validation set."""
    where = tmp_path_factory.mktemp("report") / "run"
    ran(where, settings(extra="validation.size = 60"))
    return where


@pytest.fixture(scope="module")
def html(folder: Path) -> str:
    with open_campaign(folder, write=False) as (campaign, store):
        return made(campaign, folder, store)


def test_the_page_of_a_bearing_is_whole_small_and_refers_to_nothing_outside(html):
    parsed = self_contained(html)
    assert ("html", {"lang": "en"}) in parsed.elements
    policies = [a["content"] for tag, a in parsed.elements if a.get("http-equiv") == "Content-Security-Policy"]
    assert policies == ["default-src 'none'; style-src 'unsafe-inline'; img-src data:"]
    assert html.count("<figure") == html.count("<figcaption") >= 10


def test_the_length_scales_in_the_page_of_a_bearing_are_the_classifier_s(html, folder):
    with open_campaign(folder, write=False) as (campaign, store):
        classifier = current(campaign, store, write=False).classifier
    scales = classifier.latent("failure").length_scales
    rows = Page(html).tables["lengths"][1:]
    shown = {row[0]: row[4] for row in rows}
    names = [quantity.text.replace("_", "") for quantity in quantities.features(campaign)]
    assert shown == {name: significant(float(value), 2) for name, value in zip(names, scales, strict=True)}


@pytest.mark.parametrize(
    ("features", "empty"), some([("design", True), ("design", False), ("collision", False)], ("design", True))
)
def test_other_features_of_the_bearing_have_a_page_too(features, empty, tmp_path):
    campaign = settings(features, budget=20, description="other features")
    ran(tmp_path / "run", campaign)
    drawn = slow_pictures_empty() if empty else nullcontext()
    with drawn, open_campaign(tmp_path / "run", write=False) as (campaign, store):
        parsed = self_contained(made(campaign, tmp_path / "run", store))
    assert "There are no active designs yet" in parsed.text
    assert "each design left out of the training in turn" in parsed.text
    assert "or a validation set" in parsed.text


def test_designs_with_given_features_have_them_and_lie_in_the_space():
    X = TABLE_1.latin_hypercube(200, np.random.default_rng(0))
    F = paper_features(X)
    designs, there = feature_planes.designs_with(F, TABLE_1.low, TABLE_1.high)
    assert there.mean() > 0.97  # each has at least the design it came from; projections close in slowly at corners
    assert TABLE_1.contains(designs[there]).all()
    np.testing.assert_allclose(paper_features(designs[there]), F[there], rtol=0.05)


def test_features_that_no_design_has_are_told_apart():
    F = np.tile(paper_features(0.5 * (TABLE_1.low + TABLE_1.high)[None]), (2, 1))
    F[1, 0] = 100.0  # beyond the largest pulse displacement over the smallest capacity
    _, there = feature_planes.designs_with(F, TABLE_1.low, TABLE_1.high)
    assert there.tolist() == [True, False]


def test_what_a_letter_means_is_known_of_the_bearing_s_variables_alone():
    bearing = settings()
    assert [named.meaning for named in quantities.variables(bearing)][1] == "friction coefficient"
    extra = 'classifier.features.expressions = { D_ratio = "sin(T_p)" }'
    text = TINY.format(features="paper", budget=30, description="", extra="").replace(
        'classifier.features = "paper"', extra
    )
    own = Campaign.of(parse_settings(text, "tiny"))
    named = {quantity.name: quantity.meaning for quantity in quantities.features(own)}
    assert (named["mu"], named["D_ratio"]) == ("friction coefficient", "")


def test_powers_in_units_of_the_bearing_s_variables_are_raised():
    assert quantity("k", "N/m^1.5", VARIABLES).axis == "$k$ [N/m¹·⁵]"


def test_a_report_without_a_hazard_says_how_to_add_the_fragility(folder, html):
    assert f"activefail report {folder} --hazard HAZARD.toml --fixed DESIGN.toml</code> adds the fragility" in html


@pytest.mark.usefixtures("without_pictures")
def test_the_first_box_of_a_bearing_says_what_to_do_next(html, folder):
    def step(text: str) -> str:
        return re.findall(r"<dt>next</dt><dd><code>(activefail \w+)", text)[0]

    assert step(html) == "activefail verify"
    with open_campaign(folder, write=False) as (campaign, store), one_thread():
        classifier = current(campaign, store, write=False).classifier
        found = evidence.evidence_of(campaign, store, classifier)
        findings = findings_of(folder, campaign, store, classifier)
        assert {"error", "curve"} <= set(found.missing)
        steps = []
        for name in ("error", "curve"):
            found = replace(found, missing={key: why for key, why in found.missing.items() if key != name})
            steps.append(step(page.render(findings, found, store)))
    assert steps == ["activefail compare", "activefail report"]
