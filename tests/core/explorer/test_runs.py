"""The page of all campaigns: what it says of each run folder, that it follows them, and that it opens each."""

import os
import shutil
import threading
from pathlib import Path

import pytest
from campaign.stub import Disc, disc
from explorer.conftest import Visitor, site_of, there
from explorer.test_server import ask, request
from patience import PATIENCE, until
from report.browser import console_errors, fresh
from report.test_report import ran

from activefail.analyses.findings.results import findings_of
from activefail.analyses.findings.status import estimate_of, read_status
from activefail.campaign.on_disk import create_folder
from activefail.errors import InputError
from activefail.estimates.scores import error_of
from activefail.execution.local import ThreadExecutor
from activefail.learning.model.threads import one_thread
from activefail.loop.learning import current
from activefail.loop.running import run
from activefail.pages.explorer import runs as all_runs
from activefail.pages.explorer.runs import Runs, run_folders
from activefail.pages.explorer.server import ExplorerServer
from activefail.record.run_folder import FolderStore
from activefail.text.json_text import json_text

NAME = "a <b> & 100 %"
"""Of a run folder; its address needs escapes."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a finished campaign, a stopped one, and folders that no version or only a former one reads."""
    folder = tmp_path_factory.mktemp("all")
    ran(folder / NAME, disc(extra="validation.size = 100"))
    with ThreadExecutor(1) as executor, create_folder(folder / "stopped", disc()) as store:
        run(disc(), store, executor, 16)
    shutil.copytree(folder / NAME, folder / "damaged")
    journal = folder / "damaged" / "journal"
    data = bytearray(journal.read_bytes())
    data[len(data) // 2] ^= 255
    journal.write_bytes(data)
    (folder / "old" / "segments").mkdir(parents=True)
    (folder / "old" / "campaign.toml").touch()
    (folder / "notes" / "segments").mkdir(parents=True)
    (folder / "files").mkdir()
    # A user's campaign file, beside the run folders and in a folder of its own.
    for place in (folder, folder / "files"):
        (place / "campaign.toml").touch()
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "all"))


def site_below(folder: Path):
    """The site of a campaign on the disc."""
    campaign = disc()
    with FolderStore.open(folder, campaign.schema, write=False) as store, one_thread():
        learned = current(campaign, store, write=False)
        return site_of(findings_of(folder, campaign, store, learned.classifier), home="../../")


@pytest.fixture
def runs(folder: Path):
    return Runs(folder, site_below)


def rows(runs: Runs) -> dict[str, dict]:
    """What the table shows, by folder."""
    runs.page("/")
    return {path.name: all_runs._row(path, read, 28) for path, read in runs._reads.items()}


def test_each_run_folder_is_a_row_and_one_that_cannot_be_read_says_why(runs, folder):
    shown = rows(runs)
    assert {name: row["state"] for name, row in shown.items()} == {
        NAME: "finished",
        "stopped": "stopped",
        "damaged": "unreadable",
        "old": "unreadable",
    }
    assert "and others follow it. Nothing was changed" in shown["damaged"]["fault"]
    assert "was written by activefail 0.1" in shown["old"]["fault"]
    assert (shown["stopped"]["done"], shown["stopped"]["budget"]) == (16, 28)
    summary = read_status(folder / NAME).summary
    assert shown[NAME]["counts"] == [f"{n} {name}" for name, n in zip(summary.outcomes, summary.counts, strict=False)]
    assert shown[NAME]["answer"][0] == "error on 100 validation designs, 95 % interval"
    assert len(shown[NAME]["curve"]["line"]) == len(read_status(folder / NAME).curve) > 1
    text = runs.page("/")
    assert "a &lt;b&gt; &amp; 100 %" in text
    assert 'href="run/a%20%3Cb%3E%20%26%20100%20%25/"' in text
    assert text.count("<svg") == 1
    ran(folder / "plain", disc())
    assert "<code>activefail verify</code> gives one" in runs.page("/")
    assert run_folders(folder / NAME) == []


def with_result(folder: Path, key: str, value: object) -> None:
    campaign = disc()
    with FolderStore.open(folder, campaign.schema, write=True) as store:
        of = {
            "error": error_of(store.digest),
            "estimate": estimate_of(campaign.simulator.outcomes[-1], store.digest),
            "curve": ("learning curve", str(store.batches[-1].iteration)),
        }
        store.remember(of[key], value)


ESTIMATE = dict.fromkeys(
    ("probability", "low", "high", "confidence", "simulations", "recall_low", "contradictions_where_sure"), 0.5
) | {"extrapolated": False, "question": None, "check": None}


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("error", "x"),
        ("error", {"error": 0.1, "low": 0.0, "high": 0.2, "confidence": 0.9, "simulations": 20}),
        ("estimate", {"a": 1}),
        ("estimate", ESTIMATE | {"check": {"simulations": 3}}),
        ("estimate", ESTIMATE | {"modes": {"sliding": 0.5}}),
        ("curve", [8, {"foo": 1}, None]),
        ("curve", [8, None, ["a", "b", "c"]]),
        ("curve", 5),
    ],
)
def test_a_kept_result_of_a_shape_that_this_version_does_not_write_is_left_out(runs, folder, key, value):
    with_result(folder / NAME, key, value)
    status = read_status(folder / NAME)
    assert (status.error, status.estimates, len(status.curve) > 1) == (None, {}, key != "curve")
    assert not {"error", "estimate"} & set(dict(status.lines))
    assert rows(runs)[NAME]["state"] == "finished"


def test_a_kept_estimate_is_shown_as_it_was_written(folder):
    campaign = disc()
    with FolderStore.open(folder / NAME, campaign.schema, write=True) as store:
        store.remember(estimate_of(campaign.simulator.outcomes[-1], store.digest), ESTIMATE)
    assert [*read_status(folder / NAME).estimates.values()] == [ESTIMATE]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(("curve", [n, None, [0.5, 0.4, 0.6]]) for n in (0, -3, 10**15, float("inf"), float("nan"), True)),
        *(("curve", [28, None, [p, 0.0, 1.0]]) for p in (1e308, float("-inf"), float("nan"), -1.0)),
        *(("curve", [28, of, None]) for of in (0, [], {}, 1e308)),
        *(("curve", [28, None, of]) for of in (0, [], {}, "abc")),
        *(("estimate", {"probability": p}) for p in (1e308, float("inf"), float("nan"), -1e9)),
        *(("estimate", {"simulations": n}) for n in (2**63 - 1, float("nan"))),
        *(("error", {"error": p, "low": 0.0, "high": 1.0}) for p in (1e308, float("inf"), float("nan"), -1.0)),
    ],
)
def test_a_number_in_one_folder_does_not_take_the_page_or_another_row_down(runs, folder, key, value):
    before = rows(runs)
    others = {"confidence": 0.9, "simulations": 20, "numerical_failures": 1}
    bases = {"estimate": ESTIMATE, "error": others}
    with_result(folder / NAME, key, bases[key] | value if key in bases else value)
    status = read_status(folder / NAME)
    assert status.lines
    json_text(status.as_json())
    text = runs.page("/")
    assert "campaign" in text
    after = rows(runs)
    assert {name: row for name, row in after.items() if name != NAME} == {
        name: row for name, row in before.items() if name != NAME
    }
    # The learning curves share an axis.
    assert f"{10**15}" not in text


def test_a_folder_that_takes_for_ever_to_read_is_a_row_and_appears_once_it_is_read(runs, folder, monkeypatch):
    may_end, read = threading.Event(), []

    def slow(path: Path):
        read.append(path.name)
        if path.name == "stopped":
            assert may_end.wait(PATIENCE)
        if path.name == "old":  # the one before it
            monkeypatch.setattr(all_runs, "_PATIENCE", 0.0)
        return read_status(path)

    monkeypatch.setattr(all_runs, "_PATIENCE", PATIENCE)
    monkeypatch.setattr(all_runs, "read_status", slow)
    monkeypatch.setattr(all_runs, "_SHARE", 1e9)
    first, again = rows(runs), rows(runs)
    assert (first[NAME]["state"], again[NAME]["state"]) == ("finished", "finished")
    for shown in (first, again):
        assert shown["stopped"]["state"] == "unreadable"
        assert "not read yet: this takes more than" in shown["stopped"]["fault"]
    assert read.count("stopped") == 1
    may_end.set()
    until(lambda: rows(runs)["stopped"]["state"] == "stopped", "the slow folder")
    assert read.count("stopped") == 1


def test_whatever_is_wrong_with_a_folder_is_a_row(runs, folder, monkeypatch):
    def failing(path: Path):
        if path.name == "stopped":
            raise RecursionError("maximum recursion depth exceeded\n\x1b[2J")
        return read_status(path)

    monkeypatch.setattr(all_runs, "read_status", failing)
    shown = rows(runs)
    assert shown[NAME]["state"] == "finished"
    assert shown["stopped"]["fault"] == r"cannot be read: RecursionError: maximum recursion depth exceeded\n\x1b[2J"
    monkeypatch.setattr(all_runs, "_answer", lambda status: 1 / 0)
    assert rows(runs)[NAME]["fault"] == "cannot be shown: ZeroDivisionError: division by zero"


def test_a_folder_whose_name_is_no_text_has_a_row_and_a_page(folder):
    name = os.fsdecode(b"run\xff")
    (folder / "stopped").rename(folder / name)
    with ExplorerServer("127.0.0.1", 0, Runs(folder, site_below)) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        text = request(server).text
        assert 'href="run/run%FF/"' in text
        assert r"run\udcff" in text
        assert request(server, path="/run/run%FF/").status == 200
        server.shutdown()
        thread.join()


class Stub:
    """A site that does nothing."""


def test_who_asks_an_open_campaign_does_not_wait_while_another_opens(folder):
    opening, may_end = threading.Event(), threading.Event()

    def open_site(path: Path) -> Stub:
        if path.name == "stopped":
            opening.set()
            assert may_end.wait(PATIENCE)
        return Stub()

    runs = Runs(folder, open_site)
    first = runs.below(NAME, anew=True)
    other = threading.Thread(target=runs.below, args=("stopped", True))
    other.start()
    assert opening.wait(PATIENCE)
    answered = []
    asking = threading.Thread(target=lambda: answered.append(runs.below(NAME, anew=False)), daemon=True)
    asking.start()
    asking.join(PATIENCE / 2)
    may_end.set()
    other.join()
    assert answered == [first]


def test_two_campaigns_open_at_once_and_one_that_two_ask_opens_once(folder):
    both, opened = threading.Barrier(2), []

    def open_site(path: Path) -> Stub:
        both.wait(PATIENCE)
        opened.append(path.name)
        return Stub()

    runs = Runs(folder, open_site)
    asking = [threading.Thread(target=runs.below, args=(name, True)) for name in (NAME, NAME, "stopped", "stopped")]
    for one in asking:
        one.start()
    for one in asking:
        one.join()
    assert sorted(opened) == sorted((NAME, "stopped"))


def test_of_too_many_open_campaigns_the_one_asked_longest_ago_is_closed(folder, monkeypatch):
    monkeypatch.setattr(all_runs, "_MOST_OPEN", 2)
    opened = []
    runs = Runs(folder, lambda path: opened.append(path.name) or Stub())
    one, two = runs.below(NAME, anew=True), runs.below("stopped", anew=True)
    assert runs.below(NAME, anew=True) is one
    runs.below("damaged", anew=True)
    assert runs.below(NAME, anew=False) is one
    assert runs.below("stopped", anew=False) is not two
    assert opened == [NAME, "stopped", "damaged", "stopped"]
    assert runs.below("../all", anew=True) is None


def test_a_campaign_that_could_not_be_opened_is_tried_again(folder):
    tried = []

    def open_site(path: Path) -> Stub:
        tried.append(path.name)
        if len(tried) == 1:
            raise InputError("not yet")
        return Stub()

    runs = Runs(folder, open_site)
    with pytest.raises(InputError, match="not yet"):
        runs.below(NAME, anew=True)
    assert runs.below(NAME, anew=True) is not None


def test_a_request_of_an_open_campaign_lists_no_folders(folder, monkeypatch):
    runs = Runs(folder, lambda path: Stub())
    runs.page("/")
    monkeypatch.setattr(all_runs, "run_folders", lambda _: pytest.fail("listed"))
    assert runs.below(NAME, anew=False) is not None


@pytest.mark.parametrize("name", ["journal", "checkpoint.h5"])
def test_a_users_own_file_makes_no_run_folder(tmp_path, name):
    create_folder(tmp_path / "run", disc()).close()
    (tmp_path / "notes").mkdir()
    for place in (tmp_path, tmp_path / "notes"):
        (place / name).write_text("Monday: began.")
    assert run_folders(tmp_path) == [tmp_path / "run"]


def test_an_emptied_folder_has_no_campaigns(tmp_path):
    assert "0 campaigns.</p>" in Runs(tmp_path, site_below).page("/")


def test_new_simulations_and_new_run_folders_appear_and_an_unchanged_folder_is_not_read_again(
    runs, folder, monkeypatch
):
    monkeypatch.setattr(all_runs, "_SHARE", 1e9)
    table = runs.panel("runs")
    assert table is not None
    assert table({}) == table({})
    read = []
    monkeypatch.setattr(all_runs, "read_status", lambda path: read.append(path.name) or read_status(path))
    campaign = disc()
    with (
        ThreadExecutor(1) as executor,
        FolderStore.open(folder / "stopped", campaign.schema, write=True) as store,
    ):
        run(campaign, store, executor, 20)
        assert rows(runs)["stopped"]["state"] == "running"
        assert rows(runs)["stopped"]["done"] == 20
    assert rows(runs)["stopped"]["state"] == "stopped"
    create_folder(folder / "new", disc(Disc(blind=0.0))).close()
    news = table({})
    assert ">new<" in news
    assert "0 of 28" in news
    shutil.rmtree(folder / "new")
    assert "new" not in rows(runs)
    assert set(read) == {"stopped", "new"}


def test_a_folder_that_takes_long_to_read_is_read_for_a_share_of_the_time(runs, folder, monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(all_runs.time, "monotonic", lambda: clock[0])
    read = []

    def slow(path: Path):
        read.append(path.name)
        clock[0] += 1.0
        return read_status(path)

    monkeypatch.setattr(all_runs, "read_status", slow)
    runs.page("/")
    assert read.count("stopped") == 1
    (folder / "stopped" / "journal").touch()
    runs.page("/")
    assert read.count("stopped") == 1
    clock[0] += 10.0
    runs.page("/")
    assert read.count("stopped") == 2


def test_a_campaign_is_opened_once_and_again_when_its_record_has_changed(folder):
    opened = []

    def open_site(path: Path):
        opened.append(path.name)
        return site_below(path)

    with ExplorerServer("127.0.0.1", 0, Runs(folder, open_site)) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        address = "/run/a%20%3Cb%3E%20%26%20100%20%25/"
        assert request(server, path=f"{address}explorer.css").status == 200
        assert opened == []
        shown = request(server, path=address)
        assert shown.status == 200
        assert "This design" in shown.text
        assert ask(server, "../run/a%20%3Cb%3E%20%26%20100%20%25/api/predict", {"x": 0.0, "y": 30.0}).status == 404
        for path in ("/run/nothing/", "/run/../", "/run/%2e%2e/", "/run/notes/", "/run/old", "/design"):
            assert request(server, path=path).status == 404
        assert request(server, path=address).status == 200
        assert opened == [NAME]
        (folder / NAME / "journal").touch()
        assert request(server, path=address).status == 200
        assert opened == [NAME, NAME]
        refused = request(server, path="/run/damaged/")
        assert refused.status == 409
        assert "others follow it" in refused.text
        assert 'href="../../"' in refused.text
        assert refused.headers["Content-Type"].startswith("text/html")
        server.shutdown()
        thread.join()


@pytest.mark.needs("browser")
@pytest.mark.parametrize("width", [1400, 390])
def test_the_page_follows_the_campaigns_and_leads_to_each(folder, driver, width):
    with ExplorerServer("127.0.0.1", 0, Runs(folder, site_below), needs_token=True) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        fresh(driver, max(width, 500), 900)
        size = {"width": width, "height": 844, "deviceScaleFactor": 1, "mobile": width < 500}
        driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        driver.get(server.address)
        visitor = Visitor(driver)
        assert there(visitor, ".fault", "was written by activefail 0.1")
        assert driver.execute_script("return document.documentElement.scrollWidth") <= width
        create_folder(folder / "new", disc()).close()
        visitor.driver.execute_script("document.querySelector('a').focus()")
        create_folder(folder / "newer", disc()).close()
        until(lambda: there(visitor, "th", "newer"), "the new run folders")
        assert visitor.driver.execute_script("return document.activeElement.textContent") == NAME
        pressed = "return document.activeElement.closest('tr').getAttribute('aria-busy')"
        visitor.driver.execute_script(
            "document.addEventListener('click', (event) => event.ctrlKey && event.preventDefault());"
            "const pressed = {bubbles: true, cancelable: true, ctrlKey: true};"
            "document.activeElement.dispatchEvent(new MouseEvent('click', pressed))"
        )
        assert visitor.driver.execute_script(pressed) is None
        visitor.driver.execute_script("document.activeElement.click()")
        until(lambda: driver.find_elements("css selector", "#plane svg"), "the campaign's page")
        visitor.one("nav a").click()
        until(lambda: driver.find_elements("css selector", ".runs"), "the page of all campaigns")
        assert console_errors(driver) == []
        driver.get("about:blank")
        server.shutdown()
        thread.join()
