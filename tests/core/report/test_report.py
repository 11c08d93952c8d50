"""The report: one self-contained file with the campaign's numbers, for any campaign."""

import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from campaign.stub import disc
from cases import some
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from pounding import CODE, SIMULATOR

from activefail.analyses.comparison.static import remember_scores
from activefail.analyses.findings import quantities
from activefail.analyses.findings.results import findings_of
from activefail.campaign.assembly import Campaign
from activefail.campaign.on_disk import create_folder, open_campaign
from activefail.campaign.settings import parse_settings
from activefail.estimates.scores import Recall, Score
from activefail.execution.local import ThreadExecutor
from activefail.learning.model.threads import one_thread
from activefail.loop.history import History
from activefail.loop.learning import current
from activefail.loop.progress import Observer
from activefail.loop.running import run
from activefail.pages.figures import curves, outcome_planes, samples, svg
from activefail.pages.figures.axes import outcome_colour
from activefail.pages.report import environment, evidence, page
from activefail.record.run_folder import FolderStore
from activefail.simulators.interface import Results
from activefail.space.parameter import Parameter
from activefail.space.shares import significant
from activefail.space.space import DesignSpace
from activefail.text.quantities import custom_quantity, plain, quantity

SECTIONS = (
    *("run", "outcomes", "learning", "samples", "boundaries"),
    *("reliability", "scales", "uncertain", "gallery", "reproduce"),
)
OUTCOMES = ("no_impact", "impact", "failure")
NO_VIEW = ("gallery",)
"""The section that a simulator without a view has not."""
SCRIPT = "<script>alert(1)</script> & $\\frac{"
TINY = """
description = '''{description}'''
seed = 3
sampling = {{ initial = 20, budget = {budget}, batch = 5 }}
classifier.features = "{features}"
{extra}
"""


class Page(HTMLParser):
    """What a browser would find in a page: elements with their attributes, ids, and the text of cells."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.tables: dict[str, list[list[str]]] = {}
        self._rows: list[list[str]] = []
        self._cell = False
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        parsed = dict(attrs)
        self.elements.append((tag, parsed))
        if tag == "table":
            self._rows = self.tables.setdefault(str(parsed.get("id")), [])
        elif tag == "tr":
            self._rows.append([])
        elif tag in ("td", "th"):
            self._rows[-1].append("")
        self._cell = tag in ("td", "th") or (self._cell and tag not in ("tr", "table"))

    def handle_endtag(self, tag: str) -> None:
        if tag in ("td", "th"):
            self._cell = False

    def handle_data(self, data: str) -> None:
        self.text += data
        if self._cell:
            self._rows[-1][-1] += data


def made(campaign: Campaign, folder: Path, store: FolderStore) -> str:
    with one_thread():
        classifier = current(campaign, store, write=False).classifier
        judged = evidence.evidence_of(campaign, store, classifier)
        return page.render(findings_of(folder, campaign, store, classifier), judged, store)


def ran(folder: Path, campaign: Campaign, budget: int | None = None, batches: int | None = None) -> None:
    """A run folder with the campaign taken to its budget, or stopped after some batches."""
    with create_folder(folder, campaign) as store, ThreadExecutor(2) as executor:
        stop = (lambda: len(store.batches) == batches) if batches else (lambda: False)
        run(campaign, store, executor, budget or campaign.settings.sampling.budget, Observer(stop=stop))


def settings(budget: int = 30, description: str = SCRIPT, extra: str = "") -> Campaign:
    text = TINY.format(features="design", budget=budget, description=description, extra=extra) + SIMULATOR
    return Campaign.of(parse_settings(text, "tiny"), CODE)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small campaign with a hostile name and a validation set."""
    where = tmp_path_factory.mktemp("report") / "run"
    ran(where, settings(extra="validation.size = 60"))
    return where


@pytest.fixture(scope="module")
def html(folder: Path) -> str:
    with open_campaign(folder, write=False) as (campaign, store):
        return made(campaign, folder, store)


def self_contained(text: str, without: tuple[str, ...] = ()) -> Page:
    """Assert that a page needs nothing but itself, is well made and lacks these sections alone; the page."""
    parsed = Page(text)
    assert len(text.encode()) < 2_000_000
    links = re.findall(r"https?://[^\s\"'<>]*", text)
    assert set(links) <= {"http://www.w3.org/2000/svg"}
    assert not {"script", "iframe", "object", "embed", "audio", "video"} & {tag for tag, _ in parsed.elements}
    ids = [attributes["id"] for _, attributes in parsed.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    for tag, attributes in parsed.elements:
        assert not [name for name in attributes if name.startswith("on")]
        for name in ("src", "href", "xlink:href"):
            target = attributes.get(name) or "#"
            assert target.startswith(("#", "data:")), (tag, target)
            if target.startswith("#") and len(target) > 1:
                assert target[1:] in ids
    for target in re.findall(r"url\(([^)]*)\)", text):
        assert target[0] == "#"
        assert target[1:] in ids
    assert [section for section in SECTIONS if section not in ids] == list(without)
    figures = [tag for tag, _ in parsed.elements if tag in ("figure", "figcaption")]
    assert figures[::2] == ["figure"] * (len(figures) // 2)
    assert figures[1::2] == ["figcaption"] * (len(figures) // 2)
    return parsed


# --- the page ----------------------------------------------------------------------------------------------------


def test_the_page_is_whole_small_and_refers_to_nothing_outside(html):
    parsed = self_contained(html, without=NO_VIEW)
    assert ("html", {"lang": "en"}) in parsed.elements
    policies = [a["content"] for tag, a in parsed.elements if a.get("http-equiv") == "Content-Security-Policy"]
    assert policies == ["default-src 'none'; style-src 'unsafe-inline'; img-src data:"]
    assert html.count("<figure") == html.count("<figcaption") >= 8


@pytest.mark.parametrize(
    ("p", "text"),
    [
        (0.0, "< 10⁻⁶"),
        (2.34e-5, "2.3·10⁻⁵"),
        (0.004, "4.0·10⁻³"),
        (0.01, "0.01"),
        (0.5, "0.50"),
        (0.99, "0.99"),
        (0.9964, "0.9964"),
        (0.999937, "0.999937"),
        (0.9999972, "0.999997"),
        (1.0, "> 0.999999"),
    ],
)
def test_a_probability_in_a_table_is_never_rounded_to_0_or_1(p, text):
    assert environment.probability(p) == text


def test_a_campaign_named_script_shows_as_text(html):
    parsed = Page(html)
    assert "<script" not in html
    heading = parsed.text[parsed.text.index("Results of an activefail campaign") - 200 :]
    assert SCRIPT in heading


def test_the_counts_in_the_page_are_the_record_s(html, folder):
    with open_campaign(folder, write=False) as (campaign, store):
        outcome = np.concatenate([batch.results.outcome for batch in store.batches])
        seed = np.concatenate([np.full(len(batch), batch.iteration == 0) for batch in store.batches])
    rows = {row[0]: [int(cell) for cell in row[1:]] for row in Page(html).tables["counts"][1:]}
    assert campaign.simulator.outcomes == ("no_impact", "impact", "failure")
    for title, kept in (("initial design", seed), ("active designs", ~seed), ("all", np.ones(len(seed), bool))):
        counts = [int(np.sum(outcome[kept] == label)) for label in (0, 1, 2, -1)]
        assert rows[title] == [*counts, int(kept.sum())]


def test_without_a_comparison_the_curve_is_of_the_validation_set_and_the_page_says_what_adds_the_other(html, folder):
    parsed = Page(html)
    assert f"activefail compare {folder} adds" in parsed.text
    assert f"activefail verify {folder} estimates" in parsed.text
    scores = parsed.tables["scores"][1:]
    assert [row[0] for row in scores][-1] == "30"
    assert {row[1] for row in scores} == {"active"}


@pytest.mark.usefixtures("without_pictures")
def test_the_first_box_says_what_to_do_next(html, folder):
    def step(text: str) -> str:
        return re.findall(r"<dt>next</dt><dd><code>(activefail \w+)", text)[0]

    assert step(html) == "activefail verify"
    with open_campaign(folder, write=False) as (campaign, store), one_thread():
        classifier = current(campaign, store, write=False).classifier
        found = evidence.evidence_of(campaign, store, classifier)
        findings = findings_of(folder, campaign, store, classifier)
        assert {"error", "curve"} <= set(found.missing)
        missing = {key: why for key, why in found.missing.items() if key != "error"}
        assert step(page.render(findings, replace(found, missing=missing), store)) == "activefail compare"


@pytest.mark.usefixtures("without_pictures")
def test_a_comparison_in_the_folder_is_shown_with_its_very_numbers(folder, tmp_path):
    copy = Path(shutil.copytree(folder, tmp_path / "run"))
    recall = dict.fromkeys(OUTCOMES, Recall(10, 20))
    written = [
        Score("active", 20, 0.8125, 0.79, 0.83, 0.7, -0.41, 400, recall),
        Score("active", 30, 0.9125, 0.89, 0.93, 0.8, -0.21, 400, recall),
        Score("static", 30, 0.8875, 0.86, 0.91, 0.75, -0.3125, 400, recall),
    ]
    with open_campaign(copy, write=True) as (campaign, store):
        remember_scores(store, written, 400)
        text = made(campaign, copy, store)
    rows = Page(text).tables["scores"][1:]
    assert rows[2][:6] == ["30", "static Latin hypercube", "88.75 %", "86.00 to 91.00 %", "75.00 %", "−0.3125"]
    assert "91.2 % of 400 fresh designs (89.00 to 93.00 % with 95 % confidence), after 30 simul" in Page(text).text
    assert "adds the curve of static" not in text


@pytest.mark.usefixtures("without_pictures")
def test_static_sampling_that_missed_nearly_all_failures_does_not_read_as_right(folder, tmp_path):
    copy = Path(shutil.copytree(folder, tmp_path / "run"))
    active, static = (
        {"no_impact": Recall(1800, 1800), "impact": Recall(134, 134), "failure": Recall(hits, 66)} for hits in (64, 2)
    )
    written = [
        Score("active", 30, 0.9995, 0.9972, 0.9999, 0.999, -0.01, 2000, active),
        # The page shows the one of median accuracy, as the curve and the command do.
        Score("static", 30, 0.99, 0.98, 0.995, 0.99, -0.1, 2000, active),
        Score("static", 30, 0.968, 0.96, 0.975, 0.968, -0.1, 2000, static, hypercube=1),
        Score("static", 30, 0.9, 0.88, 0.92, 0.9, -0.1, 2000, active, hypercube=2),
    ]
    with open_campaign(copy, write=True) as (campaign, store):
        remember_scores(store, written, 2000)
        parsed = Page(made(campaign, copy, store))
    assert "99.95 % of 2000 fresh designs (99.72 to 99.99 % with 95 % confidence)" in parsed.text
    after = parsed.text.partition("recall of failure")[2]
    assert after.startswith("97.0 % (64 of 66; 89.5 to 99.6 %)")
    after = parsed.text.partition("recall of failure, static design")[2]
    assert after.startswith("3.0 % (2 of 66; 0.4 to 10.5 %)")
    assert parsed.tables["scores"][3][-1] == "3.0 % (2 of 66; 0.4 to 10.5 %)"


def test_the_length_scales_in_the_page_are_the_classifier_s(html, folder):
    with open_campaign(folder, write=False) as (campaign, store):
        classifier = current(campaign, store, write=False).classifier
    scales = classifier.latent("failure").length_scales
    rows = Page(html).tables["lengths"][1:]
    shown = {row[0]: row[3] for row in rows}
    names = [quantity.text.replace("_", "") for quantity in quantities.features(campaign)]
    assert shown == {name: significant(float(value), 2) for name, value in zip(names, scales, strict=True)}


def test_the_same_folder_gives_the_same_page(html, folder):
    assert "The same versions on the same kind of processor give the same bits." in html
    with open_campaign(folder, write=False) as (campaign, store):
        assert made(campaign, folder, store) == html


# --- other campaigns ---------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("without_pictures")
def test_a_part_of_the_seed_is_enough_for_a_page_that_says_how_to_go_on(tmp_path):
    ran(tmp_path / "run", settings(description=""), batches=1)
    with open_campaign(tmp_path / "run", write=False) as (campaign, store):
        parsed = self_contained(made(campaign, tmp_path / "run", store), without=NO_VIEW)
    assert "25 of the planned simulations are left" in parsed.text
    assert f"activefail resume {tmp_path / 'run'} continues" in parsed.text


@pytest.mark.usefixtures("without_pictures")
def test_the_page_says_when_running_it_again_is_not_the_same(tmp_path):
    ran(tmp_path / "run", settings(budget=23))
    opened = open_campaign(tmp_path / "run", write=True, code=CODE)
    with opened as (campaign, store), ThreadExecutor(2) as executor:
        run(campaign, store, executor, 32)
        parsed = self_contained(made(campaign, tmp_path / "run", store), without=NO_VIEW)
    assert "32, beyond the 23 planned" in parsed.text
    assert "12 in 3 batches of 5" in parsed.text
    assert "earlier end left a batch of fewer than 5" in parsed.text


@pytest.mark.usefixtures("without_pictures")
def test_the_page_of_a_campaign_without_batches_promises_no_second_of_its_kind(tmp_path):
    text = TINY.format(features="design", budget=30, description="", extra="") + SIMULATOR
    text = text.replace("batch = 5", "batch = 5, asynchronous = true")
    campaign = Campaign.of(parse_settings(text, "tiny"), CODE)
    ran(tmp_path / "run", campaign)
    with open_campaign(tmp_path / "run", write=False) as (campaign, store):
        parsed = self_contained(made(campaign, tmp_path / "run", store), without=NO_VIEW)
    assert "10, asynchronous, up to 5 in flight" in parsed.text
    assert "Another run proposes other designs" in parsed.text


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_another_simulator_has_a_page_without_bearings(dimension, tmp_path):
    extra = "validation.size = 40" if dimension == 2 else ""
    campaign = disc(extra=extra) if dimension == 2 else other(dimension)
    ran(tmp_path / "run", campaign)
    with FolderStore.open(tmp_path / "run", campaign.schema, write=False) as store:
        parsed = self_contained(made(campaign, tmp_path / "run", store), without=NO_VIEW)
    assert "Bearings at the boundary" not in parsed.text
    labels = [a["aria-label"] for tag, a in parsed.elements if tag == "svg"]
    drawn = [label for label in labels if label.startswith("Probabilities in the plane")]
    assert len(drawn) == {1: 0, 2: 1, 3: 9}[dimension]
    assert len(set(drawn)) == {1: 0, 2: 1, 3: 9}[dimension]


def other(dimension: int) -> Campaign:
    """A campaign on a ball in some variables whose unit would be mathtext."""
    from campaign.stub import Disc

    class Ball(Disc):
        def run(self, X: Any) -> Any:
            near = np.column_stack([X, np.zeros((len(X), 2))])[:, :2] * 2.0
            return super().run(near + np.array([0.0, 24.0]))

    space = "\n".join(f'space.x{i} = {{ low = -1.0, high = 1.0, unit = "$\\\\frac{{" }}' for i in range(dimension))
    text = f"""
        seed = 1
        sampling = {{ initial = 12, budget = 16, batch = 4 }}
        simulator = {{ python = "ball:run", outcomes = ["safe", "broken"], repeatable = true }}
        classifier.features = "design"
        acquisition.boundary = "broken"
        {space}
        """
    return Campaign.of(parse_settings(text, "ball"), simulator=Ball())


# --- its pieces --------------------------------------------------------------------------------------------------


def test_an_inlined_figure_keeps_its_marks_and_names_nothing_twice():
    figure = Figure()
    axes = figure.add_subplot()
    axes.scatter(range(30), range(30))
    axes.set_title("a < b -- > c")
    text = str(svg.inline(figure, "one", 'say "it"'))
    assert text.startswith('<svg role="img" aria-label="say &#34;it&#34;"')
    assert "<!--" not in text
    assert "xlink" not in text
    (path,) = re.findall(r'<path d="M([^"]*)" fill="none" marker-start', text)
    assert len(path.split("L")) == 30
    ids = re.findall(r'\bid="([^"]*)"', text)
    assert len(ids) == len(set(ids))
    assert all(name.startswith("one-") for name in ids)


def test_pairs_of_ten_thousand_designs_are_drawn_with_some_of_each_kind_and_stay_small():
    rng = np.random.default_rng(0)
    outcome, chosen = rng.integers(0, 3, 10_000).astype(np.int8), np.arange(10_000) >= 4_000
    names = [quantity(f"x{i}") for i in range(6)]
    figure = samples.plot_pairs(rng.random((10_000, 6)), outcome, chosen, names, [False] * 6, ("a", "b", "c"))
    shown = [sum(len(c.get_offsets()) for c in axes.collections) for axes in figure.axes]
    assert shown == [0 if row == column else samples.MOST_SHOWN for row in range(6) for column in range(6)]
    assert len(svg.inline(figure, "pairs", "pairs")) < 600_000


DAMAGE = ("no damage", "slight damage", "moderate damage", "severe structural damage")


def assert_text_is_inside(figure: Figure) -> None:
    """Assert that legend, labels and titles lie within the figure, and that titles of one row do not meet."""
    FigureCanvasAgg(figure).draw()
    texts = [
        text for axes in figure.axes for text in (axes.xaxis.label, axes.yaxis.label, axes.title, axes._left_title)
    ]
    for artist in (*figure.legends, *(text for text in texts if text.get_text())):
        box = artist.get_window_extent()
        assert figure.bbox.x0 <= box.x0, artist
        assert box.x1 <= figure.bbox.x1, artist
        assert figure.bbox.y0 <= box.y0, artist
        assert box.y1 <= figure.bbox.y1, artist
    titles = [axes._left_title.get_window_extent() for axes in figure.axes if axes._left_title.get_text()]
    (legend,) = figure.legends
    for number, box in enumerate(titles):
        assert not legend.get_window_extent().overlaps(box)
        assert not any(box.overlaps(other) for other in titles[number + 1 :])


@pytest.mark.parametrize("outcomes", [DAMAGE[:2], DAMAGE])
@pytest.mark.parametrize("m", some(range(1, 7), 1, 2, 3, 6))
def test_a_picture_of_pairs_has_room_for_long_names(m, outcomes):
    rng = np.random.default_rng(1)
    names = [quantity(f"concrete_compressive_strength_{i}", "kN/m^2") for i in range(m)]
    outcome = rng.integers(0, len(outcomes), 40).astype(np.int8)
    F = 1e5 * rng.random((40, m))
    assert_text_is_inside(samples.plot_pairs(F, outcome, np.arange(40) > 20, names, [False] * m, outcomes))


@pytest.mark.parametrize("outcomes", [DAMAGE[:2], DAMAGE])
@pytest.mark.parametrize("third", [-1, 2])
def test_a_picture_of_planes_has_room_for_long_names(third, outcomes):
    rng = np.random.default_rng(1)
    names = [quantity(f"concrete_compressive_strength_{i}", "kN/m^2") for i in range(3)]

    def predicted(rows):
        P = np.full((len(rows), len(outcomes)), 1.0 / len(outcomes))
        P[:6] = np.nan
        unknown = np.arange(len(rows)) % 7 == 6
        return SimpleNamespace(probabilities=P, high=P[:, 0] + 0.1, low=P[:, 0], beyond=P[:, -1], undecided=unknown)

    plane = outcome_planes.Plane(0, 1, third, (12000.0, 15000.0, 18000.0))
    F = 1e5 * rng.random((40, 5))
    space = DesignSpace(tuple(Parameter(f"concrete_compressive_strength_{i}", 0.0, 1e5) for i in range(5)))
    c = outcome_planes.Coordinates(names, F, F.mean(axis=0), predicted, [plane], lambda *_: 1500.0)
    outcome, none = rng.integers(0, len(outcomes), 40).astype(np.int8), np.zeros(40)
    findings = SimpleNamespace(
        campaign=SimpleNamespace(simulator=SimpleNamespace(outcomes=outcomes), space=space),
        history=History.of_sample(F, Results(outcome, none.astype(np.int8), np.empty((40, 0)), none)),
        beyond=outcomes[-1],
    )
    for figure in outcome_planes.plot_outcome_planes(plane, c, findings):
        assert_text_is_inside(figure)


@pytest.mark.parametrize("outcome", [DAMAGE[0], DAMAGE[-1]])
@pytest.mark.parametrize(
    ("name", "unit", "low", "high"),
    [("A_p", "g", 0.1, 0.8), ("concrete_compressive_strength", "kN/m^2", 1e5, 9e5), ("k", "N/m^1.5", 1.7e9, 3.3e9)],
)
def test_a_curve_has_room_for_long_names_and_for_ticks_of_many_digits(name, unit, low, high, outcome):
    x, along, event = np.linspace(low, high, 9), quantity(name, unit), plain(outcome)
    p = np.linspace(0.0, 1.0, 9)
    for figure in (
        curves.plot_fragility(x, SimpleNamespace(beyond=p, low=0.9 * p, high=p), along, event, low, "black"),
        curves.plot_required_value(x, 0.001 * p, 0.001, high, along, event, "black"),
    ):
        assert_text_is_inside(figure)
        (axes,), (legend,) = figure.axes, figure.legends
        panel = axes.get_tightbbox()
        assert figure.bbox.x0 <= panel.x0 <= panel.x1 <= figure.bbox.x1
        assert figure.bbox.y0 <= panel.y0
        assert not legend.get_window_extent().overlaps(panel)


def test_the_spread_of_a_variable_is_told_in_words():
    assert page.spread(Parameter("a", 1.0, 2.0)) == "uniform"
    assert page.spread(Parameter("b", 1.0, 2.0, distribution="log_uniform")) == "log-uniform"
    normal = Parameter("c", 1.0, 2.0, distribution="truncated_normal", mean=1.5, sd=0.25)
    assert page.spread(normal) == "truncated normal, 1.50 ± 0.250, within the bounds"
    assert page.spread(replace(normal, distribution="gumbel_max")) == "Gumbel (max), 1.50 ± 0.250, within the bounds"
    assert page.spread(replace(normal, distribution="beta")) == "beta, 1.50 ± 0.250"
    waiting = replace(normal, distribution="exponential", sd=None)
    assert page.spread(waiting) == "exponential, mean 1.50, within the bounds"


def test_powers_in_units_are_raised():
    assert quantity("k", "N/m^1.5").axis == "k [N/m¹·⁵]"
    assert quantity("gust", "m/s^-2").axis == "gust [m/s⁻²]"
    assert quantity("cost", "$^").axis == r"cost [\$^]"


@pytest.mark.usefixtures("without_pictures")
def test_the_page_names_the_commands_that_judged_it(folder, tmp_path):
    copy = Path(shutil.copytree(folder, tmp_path / "run"))
    row = (0.9, 0.8, 0.95, 0.7, -0.4, 388, dict.fromkeys(OUTCOMES, Recall(10, 20)))
    written = [Score(name, n, *row) for n in (20, 30) for name in ("active", "static")]
    with open_campaign(copy, write=True) as (campaign, store):
        remember_scores(store, written, 400)
        parsed = Page(made(campaign, copy, store))
    run = f"activefail run campaign.toml --out {copy}"
    assert f"{run}\nactivefail compare {copy} --budgets 20,30 --test 400\nactivefail report {copy}\n" in parsed.text


def test_numbers_are_written_as_people_read_them():
    assert [significant(x) for x in (0.0, 0.05, 12.345, 2.5e8, -0.5, 1234.0)] == [
        "0",
        "0.0500",
        "12.3",
        "2.50·10⁸",
        "−0.500",
        "1234",
    ]


# --- colours -----------------------------------------------------------------------------------------------------

# Machado, Oliveira and Fernandes 2009, Table 1, severity 1.0, on linear RGB.
VISION = {
    "usual": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}


def lab(colour: str, vision: str) -> np.ndarray:
    """CIE L*a*b* of a colour as an eye sees it."""
    rgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    seen = np.clip(VISION[vision] @ linear, 0.0, 1.0)
    to_xyz = np.array([[0.4125, 0.3576, 0.1804], [0.2127, 0.7152, 0.0722], [0.0193, 0.1192, 0.9503]])
    x, y, z = np.cbrt(to_xyz @ seen / (0.9505, 1.0, 1.0888))
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


@pytest.mark.parametrize("vision", VISION)
@pytest.mark.parametrize("outcomes", [("no_impact", "impact", "failure"), ("safe", "broken")])
def test_the_outcomes_colours_are_told_apart_by_every_eye(outcomes, vision):
    colours = [outcome_colour(outcomes, index) for index in range(len(outcomes))]
    seen = [lab(colour, vision) for colour in colours]
    # 2.3 is a just noticeable difference (Mahy et al. 1994).
    for i in range(len(seen)):
        for j in range(i):
            assert np.linalg.norm(seen[i] - seen[j]) > 6 * 2.3, (colours[i], colours[j])


@pytest.mark.parametrize(
    ("name", "symbol", "text"),
    [
        ("mu", r"$\mu$", "μ"),
        ("mu_1", r"$\mu_{1}$", "μ_1"),
        ("peak_drift", "peak_drift", "peak drift"),
        ("a_$b", r"a_\$b", "a $b"),
    ],
)
def test_a_name_of_one_s_own_is_a_symbol_where_it_is_a_letter_and_has_no_meaning(name, symbol, text):
    named = custom_quantity(name, "s")
    assert (named.symbol, named.text, named.unit, named.meaning) == (symbol, text, "s", "")
