"""Files of ground-motion records, right and wrong ones, and the command that simulates one."""

import re
from pathlib import Path

import numpy as np
import pytest
from commandline import activefail, refused

from activefail import read_accelerogram
from activefail.errors import InputError
from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.motions.accelerogram_files import UNITS, doubts

HEADER = "PEER NGA STRONG MOTION DATABASE RECORD\nNorthridge, 1994\nACCELERATION TIME SERIES IN UNITS OF G\n"


def written(folder: Path, text: str) -> Path:
    path = folder / "record.txt"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    "counts",
    ["NPTS=   7, DT=   .0100 SEC,", "NPTS= 7, DT= 0.01 SEC", "   7    0.0100    NPTS, DT", "npts = 7 dt = 1.0D-2"],
)
def test_at2_files_are_read(tmp_path: Path, counts: str) -> None:
    text = HEADER + counts + "\n  .1000000E-01  -.2000000E-01 3E-2\n 0.04 0.05\n.06\n-7.0D-2"
    record = read_accelerogram(written(tmp_path, text), "g")
    assert record.dt == pytest.approx(0.01)
    assert record.acceleration == pytest.approx(GRAVITY * np.array([0.01, -0.02, 0.03, 0.04, 0.05, 0.06, -0.07]))
    assert record.name == "record"


@pytest.mark.parametrize("separator", [" ", ",", "\t", ", "])
def test_columns_are_read(tmp_path: Path, separator: str) -> None:
    rows = "".join(f"{0.005 * k:.4f}{separator}{k * k - 3}\n" for k in range(5))
    record = read_accelerogram(written(tmp_path, "# comment\ntime acceleration\n" + rows), "cm/s2")
    assert record.dt == pytest.approx(0.005)
    assert record.acceleration == pytest.approx([-0.03, -0.02, 0.01, 0.06, 0.13])


@pytest.mark.parametrize("title", ["Time [ms], Acc [g]", "time (msec) a", "t\ttime_ms\tacc_g"])
def test_a_column_of_milliseconds_is_understood(tmp_path: Path, title: str) -> None:
    record = read_accelerogram(written(tmp_path, f"{title}\n0 1\n5 2\n10 3\n"), "g")
    assert record.dt == pytest.approx(0.005)
    with pytest.raises(InputError, match=r"dt: the times have an interval of 0\.005 s, got 5 s"):
        read_accelerogram(written(tmp_path, f"{title}\n0 1\n5 2\n10 3\n"), "g", 5.0)


def test_commas_between_columns_are_not_taken_for_decimals(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"line 3: times must rise by equal intervals \(.*\), got 0.2 s\.$"):
        read_accelerogram(written(tmp_path, "0.1,1\n0.2,1\n0.4,1\n0.5,1\n"), "g")


def test_text_in_utf_16_is_refused(tmp_path: Path) -> None:
    (tmp_path / "record.txt").write_bytes("0.1\n0.2\n".encode("utf-16"))
    with pytest.raises(InputError, match=r"record.txt: must be text in UTF-8 or ASCII, got UTF-16\."):
        read_accelerogram(tmp_path / "record.txt", "g", 0.01)


def test_a_single_column_needs_its_interval(tmp_path: Path) -> None:
    path = written(tmp_path, "0.1\n-0.2\n")
    assert read_accelerogram(path, "m/s2", 0.02).acceleration.tolist() == [0.1, -0.2]
    with pytest.raises(InputError, match=r"dt \(--dt\) is required"):
        read_accelerogram(path, "m/s2")


def test_times_that_are_rounded_are_even(tmp_path: Path) -> None:
    rows = "".join(f"{k / 300.0:.3f} {k}\n" for k in range(300))
    assert read_accelerogram(written(tmp_path, rows), "m/s2").dt == pytest.approx(1.0 / 300.0, rel=1e-3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "must have accelerations, got none"),
        (HEADER + "NPTS= 2, DT= 0,01 SEC\n0.1\n0.2\n", "DT: must have a decimal point, got 'NPTS= 2, DT= 0,01 SEC'."),
        ("words only\n", "must have accelerations, got none"),
        ("0\n0,12\n", "as many as the first line, got '0,12'. Commas separate numbers; decimals need points."),
        ("0,12\n0,15\n0,1\n", "(median: 0 s), got 0 s. Commas separate numbers; decimals need points."),
        ("0.00 1\n0.01 2\n0.03 3\n0.04 4\n", "line 3: times must rise by equal intervals"),
        ("0.00 1\n0.01 2\n0.02 3\n0.022 4\n", "line 4: times must rise by equal intervals"),
        ("0.02 1\n0.01 2\n0.00 3\n", "times must rise by equal intervals"),
        ("0.00 1\n0.00 2\n", "times must rise by equal intervals"),
        ("".join(f"{0.01 * k:.6f} 1\n" for k in range(30) if k != 20), "line 21: times must rise by equal intervals"),
        (
            HEADER.replace("UNITS OF G", "UNITS OF CM/S/S") + "NPTS= 2, DT= 1\n1 2\n",
            "unit: the header states cm/s2, got g (line 3: ",
        ),
        (
            HEADER.replace("ACC", "VELOCITY TIME SERIES IN UNITS OF CM/S\nACC") + "NPTS= 2, DT= 1\n1 2\n",
            "line 3: must state an acceleration",
        ),
        (
            "".join(f"{0.02 * k + 0.01 * max(k - 250, 0):.6f} 1\n" for k in range(500)),
            "line 252: times must rise by equal intervals (median: 0.02 s), got 0.03 s",
        ),
        ("0.00 1\n0.01 1e75\n", "sample 2 must be at most 1e+75 m/s2 in magnitude, got 9.81e+75"),
        ("0.00 1\n0.01 nan\n", "line 2: must be finite, got 'nan'"),
        ("0.00 1\n0.01 2 3\n", "line 2: must have one or two numbers"),
        ("0.00 1\n", "at least 2 samples"),
        (HEADER + "NPTS= 3, DT= 0.01\n1 2\n", "points: 3 are stated, but 2 accelerations follow"),
        (HEADER + "NPTS= 3, DT= 0.01\n1 2 3\n4 5 6\n7 8 9\n", "points: 3 are stated, but 9 accelerations follow"),
        (HEADER + "NPTS= 4, DT= 0.01\n0 2\n1 5\n2 8\n", "points: 4 are stated, but 6 accelerations follow"),
        (HEADER + "NPTS= 2, DT= 0.01\n1 x\n", "line 5: must be numbers, got 'x'"),
        (HEADER + "NPTS= 1, DT= 0.01\n1\n", "at least 2 samples"),
        (HEADER + "NPTS= 2, DT= 0\n1 2\n", "dt: must be positive"),
        ("1e999 2\n2 3\n", "line 1: must be finite"),
    ],
)
def test_a_wrong_file_is_refused_by_name(tmp_path: Path, text: str, message: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(InputError, match=re.escape(message)) as refusal:
        read_accelerogram(path, "g")
    assert str(path) in str(refusal.value)


def test_a_wrong_unit_or_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="unit: must be one of g, m/s2, cm/s2, mm/s2, got 'mm'"):
        read_accelerogram(written(tmp_path, "0 1\n1 2\n"), "mm")
    for path in (tmp_path / "none.txt", tmp_path):
        with pytest.raises(InputError, match=re.escape(str(path))):
            read_accelerogram(path, "g")


def test_a_mark_of_utf8_does_not_hide_the_first_sample(tmp_path: Path) -> None:
    path = tmp_path / "marked.txt"
    path.write_bytes(b"\xef\xbb\xbf0.1\n-0.2\n0.3\n")
    assert read_accelerogram(path, "m/s2", 0.02).acceleration.tolist() == [0.1, -0.2, 0.3]


@pytest.mark.parametrize("dt", [float("nan"), 0.0, -1.0, float("inf")])
def test_an_interval_that_is_none_is_refused_even_if_the_file_has_times(tmp_path: Path, dt: float) -> None:
    with pytest.raises(InputError, match=r"record\.txt: dt: must be positive and finite"):
        read_accelerogram(written(tmp_path, "0 1\n1 2\n"), "g", dt)


ESM = "EVENT_NAME: X\nSAMPLING_INTERVAL_S: 0.005\nNDATA: 3\nUNITS: cm/s^2\nPGA_CM/S^2: 2.0\nDATA_TYPE: ACCELERATION\n"
HEADERS = [
    (ESM, "cm/s2", 0.005),
    ("PEAK ACC (g): 0.003\nunits: gal\ntime step (s) = 5e-3\nnumber of points = 3\n", "cm/s2", 0.005),
    ("ACCELERATION (CM/S/S)\nNO. OF POINTS: 3\nSAMPLING RATE (Hz): 200\n", "cm/s2", 0.005),
    ("Accel. [m/s²]\n3 points at equal spacing of 0.005 sec\n8 points across in a row\n", "m/s2", 0.005),
    ("# sampling interval: 5 ms\n# unit = cm/sec**2\n", "cm/s2", 0.005),
    ("Number of data: 3\nSampling frequency: 200 Hz\nAmplitudeUnit: gal. DCoffset(corr)\n", "cm/s2", 0.005),
    ("acc_g\ndata at .005 sec intervals\n", "g", 0.005),
    ("The units are (mm/s/s)\nNPTS: 3, DT: 0.005\n", "mm/s2", 0.005),
]


@pytest.mark.parametrize(("header", "unit", "dt"), HEADERS)
def test_what_a_header_states_is_taken_and_no_option_overrules_it(
    tmp_path: Path, header: str, unit: str, dt: float
) -> None:
    path = written(tmp_path, header + "1\n-2\n3\n")
    record = read_accelerogram(path)
    assert record.dt == pytest.approx(dt)
    assert record.acceleration == pytest.approx(UNITS[unit] * np.array([1.0, -2.0, 3.0]))
    assert read_accelerogram(path, unit, dt).acceleration.tolist() == record.acceleration.tolist()
    wrong = "m/s2" if unit != "m/s2" else "g"
    with pytest.raises(InputError, match=rf"record.txt: unit: the header states {unit}, got {wrong} \(line \d"):
        read_accelerogram(path, wrong)
    with pytest.raises(InputError, match=r"record.txt: dt: the header states 0\.005 s, got 0\.01 s \(line \d"):
        read_accelerogram(path, unit, 0.01)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("", "unit: the header states none, so it is required (--unit"),
        ("UNITS: cm/s\n", "line 1: must state a unit of acceleration"),
        ("UNITS: g/10\n", "line 1: must state a unit of acceleration"),
        ("DATA_TYPE: VELOCITY\n", "line 1: must state an acceleration"),
        ("UNITS: g\nNPTS= 3, DT= 0.01\nsampling rate: 200 Hz\n", "dt: the header states 0.005 s, got 0.01 s (line 3"),
        ("unit: g\nacceleration (gal)\n", "unit: the header states cm/s2, got g (line 2"),
    ],
)
def test_a_header_that_says_too_little_or_contradicts_itself_is_refused(
    tmp_path: Path, header: str, message: str
) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        read_accelerogram(written(tmp_path, header + "1\n-2\n3\n"), None, None if "DT" in header else 0.01)


@pytest.mark.parametrize("first", ["0.01", "3", "3\n0.01", "0.01\n3", "3 0.01", "0.01, 3"])
def test_a_first_line_that_is_the_interval_or_the_number_of_points_is_no_sample(tmp_path: Path, first: str) -> None:
    path = written(tmp_path, first + "\n1\n-2\n3\n")
    record = read_accelerogram(path, "m/s2", 0.01)
    assert (record.acceleration.tolist(), record.dt) == ([1.0, -2.0, 3.0], 0.01)
    said = " and ".join(first.replace(",", " ").split())
    assert f"record begins with {said}, which is no acceleration" in doubts(record)[0]
    if len(first) > 5:
        assert read_accelerogram(path, "m/s2").acceleration.tolist() == [1.0, -2.0, 3.0]
    with pytest.raises(InputError, match="sample 1: must be an acceleration, got 4000, and the others are at most 3"):
        read_accelerogram(written(tmp_path, "4000\n1\n-2\n3\n"), "m/s2", 0.01)


@pytest.mark.parametrize(
    ("data", "note"),
    [
        ("1 -2 3 4 5\n-6 7\n*** End Data ***\n\n", ""),
        ("1 -2 3 4 5\n-6 7\n\x1a", ""),
        ("1 -2 3 4 5\n-6 7 0 0 0\n", "has 3 more values than its 7 points; they are left out."),
        ("1\n-2\n3\n4\n5\n-6\n7\n8\n", "has 1 more values than its 7 points; they are left out."),
        ("1.0-2.0 3. 4.\n.5D+1-6. 7.000-000\n", ""),
    ],
)
def test_at2_files_are_read_as_they_are_found(tmp_path: Path, data: str, note: str) -> None:
    record = read_accelerogram(written(tmp_path, HEADER + "NPTS:   7, DT: .01 SEC\n" + data))
    assert record.acceleration == pytest.approx(GRAVITY * np.array([1, -2, 3, 4, 5, -6, 7]))
    assert list(record.notes) == [note] * bool(note)


def test_lines_of_a_few_samples_are_read_one_after_the_other_unless_they_may_be_components(tmp_path: Path) -> None:
    for text in ("1 -2 3\n4 5 -6\n7\n", "1 -2 3 4 5\n-6 7 8 9 0\n4 4 4 4 4\n"):
        record = read_accelerogram(written(tmp_path, text), "m/s2", 0.01)
        assert record.acceleration.tolist() == list(map(float, text.split()))
        assert "accelerations to a line, which are read one after the other" in record.notes[0]
    for text in ("1 -2 3\n4 5 -6\n7 8 9\n", "0 1 2 3 4\n0.1 1 2 3 4\n0.2 1 2 3 4\n", "1 2 3\n4 5\n6 7 8\n"):
        with pytest.raises(InputError, match=r"must have one or two numbers, .* More need a header with NPTS and DT"):
            read_accelerogram(written(tmp_path, text), "m/s2", 0.01)


@pytest.mark.parametrize("fact", ["Gravity: 9.81 (m/s2)", "Target Sa(T1) = 0.5 (g)"])
def test_the_unit_of_a_number_is_not_that_of_the_samples(tmp_path: Path, fact: str) -> None:
    text = f"{fact}\n0.1\n-0.2\n"
    with pytest.raises(InputError, match="unit: the header states none"):
        read_accelerogram(written(tmp_path, text), dt=0.01)
    assert read_accelerogram(written(tmp_path, text), "cm/s2", 0.01).acceleration == pytest.approx([0.001, -0.002])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("Sampling rate: 0.1 kHz\n0.1\n-0.2\n", "must state an interval in s or ms, or a rate in Hz"),
        ("Time [us], Acc\n0 1\n5 2\n", "must state times in s or ms"),
        ("Time (s), Velocity (cm/s)\n0 1\n1 2\n", "must state an acceleration"),
        ("T (s) response spectrum\n0 1\n1 2\n", "must state an acceleration"),
        ("20.5678123.4567234.5678\n", "must be numbers"),
        ("nan\n0.1\n0.2\n", "must be finite, got 'nan'"),
        ("9.81\n0.1\n-0.2\n", "must be an acceleration, got 9.81"),
        ("UNITS OF G'S\n0.1\n", "unit: the header states g, got cm/s2"),
    ],
)
def test_what_is_no_acceleration_is_refused(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        read_accelerogram(written(tmp_path, text), "cm/s2", 0.01)


MARKED = "0.1\n0.2\n-999\n0.1\n-999\n0.3\n"
TIMES = "\n".join(f"{k} 0.{k}" for k in range(1, 6))


@pytest.mark.parametrize(
    ("text", "dt", "says"),
    [
        *((f"{fact}\n0.1\n-0.2\n", 0.01, "dt: the header states 0.005 s, got 0.01 s (line 1: ") for fact in (
            "Frequency: 200 Hz", "Samples every 5 ms", "DELTA-T 5.0 MSEC", "Step 5.0 milliseconds",
            "Spacing used: 0.005 s", "Digitized with .005 seconds", "Rate 200 Hz", "(5.0D-3 sec)",
        )),
        ("PGA: 0.35 cm/s/s\n0.2\n-0.35\n", 0.01, "line 1: must agree with the largest of the samples, 0.35 g"),
        ("Max. acc. (gal) = -350\n200\n-350\n", 0.01, "line 1: must agree with the largest of the samples, 350 g, got"),
        ("PGA_M/S^2: 3.5\nPGA_G 0.1\n0.2\n-0.36\n", 0.01, "line 2: must agree with the largest"),
        ("0,10 0,20 -0,30\n0,10 0,20 0,30\n0,1\n", 0.01, "line 1: must have decimal points, got '0,10 0,20 -0,30'"),
        ("0,00;0,1\n0,01;0,2\n", None, "line 1: must have decimal points, got '0,00;0,1'"),
        ("0,00\t1,2E-03\n0,01\t0,2\n", None, "line 1: must have decimal points"),
        (MARKED, 0.01, "sample 3: must be an acceleration, got -999, and the others are at most 0.3. Remove"),
        (MARKED.replace("999", "1e20"), 0.01, "sample 3: must be an acceleration, got -1e+20"),
        (TIMES, None, "line 2: times must rise by less than 1 s, got 1 s. If the first column counts samples, dt"),
        ("0 0.1\n5 0.2\n10 0.1\n", None, "line 2: times must rise by less than 1 s, got 5 s."),
    ],
)  # fmt: skip
def test_what_contradicts_the_samples_or_the_option_is_refused(
    tmp_path: Path, text: str, dt: float | None, says: str
) -> None:
    with pytest.raises(InputError, match=re.escape(says)):
        read_accelerogram(written(tmp_path, text), "g", dt)


@pytest.mark.parametrize(
    "header",
    [
        "Rate 100 Hz", "Filter 0.1 Hz to 25 Hz", "Natural frequency of the sensor: 50 Hz", "HP 0.05 Hz, LP 30 Hz",
        "Rate 200 m/s", "PGA: 0.35 g at 5.2 s", "PGA: 35 %g", "Peak acceleration = -343.2 cm/sec/sec",
        "Multiple components: 3", "Scale factor: 1.00", "0.1 m/s2 = 10 gal", "g = 9.81 m/s2", "Vs30 [m/s] 760",
        "Vs30 (m/s): 760", "converted from cm/s2", "2 counts", "Number of counts: 2", "Count: 2", "Peak (gal) 343",
    ],
)  # fmt: skip
def test_numbers_that_agree_or_mean_something_else_are_no_contradiction(tmp_path: Path, header: str) -> None:
    record = read_accelerogram(written(tmp_path, f"{header}\n0.2\n-0.35\n"), "g", 0.01)
    assert (record.peak, record.notes) == (pytest.approx(0.35 * GRAVITY), ())
    # Of a file with a factor, the samples may be multiplied already.
    record = read_accelerogram(written(tmp_path, f"{header}\nScale factor = 2.5\n0.2\n-0.35\n"), "g", 0.01)
    assert record.notes == ("has a factor in its header, which is not applied: 'Scale factor = 2.5'.",)


@pytest.mark.parametrize(
    ("header", "unit"),
    [
        ("Aceleración en m/s2", "m/s2"), ("Beschleunigung m/s^2, Station 4", "m/s2"), ("Ivme, gal", "cm/s2"),
        ("acceleration in metres per second squared", "m/s2"), ("in centimeters/second/second", "cm/s2"),
        ("Acceleration, inches per second squared", None), ("acc in g/10", None), ("Acceleration in % g", None),
        ("acceleration in percent of g", None), ("Acceleration (µg)", None), ("raw data, counts", None),
        ("cm/s", None), ("jerk m/s3", None), ("Displacement (cm)\nStation 4", None), ("T (s)  Sa (g)", None),
    ],
)  # fmt: skip
def test_a_unit_in_any_words_must_be_that_of_the_option(tmp_path: Path, header: str, unit: str | None) -> None:
    path = written(tmp_path, f"{header}\n0.1\n-0.3\n0.2\n")
    for option in UNITS:
        if option == unit:
            assert read_accelerogram(path, option, 0.01).peak == pytest.approx(0.3 * UNITS[option])
        else:
            with pytest.raises(InputError, match="line 1"):
                read_accelerogram(path, option, 0.01)


def test_a_column_that_counts_is_left_out_if_the_interval_is_known_and_quoted_cells_are_read(tmp_path: Path) -> None:
    for text, dt in ((TIMES, 0.01), (f"NPTS= 5, DT= .01\n{TIMES}", None)):
        record = read_accelerogram(written(tmp_path, text), "g", dt)
        assert (record.dt, record.acceleration[-1]) == (0.01, pytest.approx(0.5 * GRAVITY))
        assert record.notes == ("has a first column that counts the samples; it is left out.",)
    quoted = '"Time (s)","Acc (g)"\n"0.00","0.1"\n"0.01","-.2D0"\n"0.02","0.123-105"\n'
    assert read_accelerogram(written(tmp_path, quoted)).peak == pytest.approx(0.2 * GRAVITY)


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("Origin Time       2011/03/11\nScale Factor      3920(gal)/6182761\n  1 2\n", "K-NET"),
        ("2 CORRECTED ACCELEROGRAM\n*\n", "SMC"),
        ("Corrected acceleration    (Format v01.20 with 13 text lines)\n", "COSMOS"),
        ("Corrected accelerogram 20161113_110256_WTMC_20 GNS Science\n", "GeoNet"),
        ("Corrected accelerogram   89146-L2500-12044.02       Chan  1: 360 Deg\n", "CSMIP"),
    ],
)
def test_formats_of_agencies_are_refused_by_name(tmp_path: Path, text: str, name: str) -> None:
    with pytest.raises(InputError, match=f"record.txt is a file in {name}'s format, which activefail does not read"):
        read_accelerogram(written(tmp_path, text + "1 2\n"), "g", 0.01)
    (tmp_path / "record.txt").write_bytes(b"1 2\n\0")
    with pytest.raises(InputError, match=r"record\.txt: must be text, got a binary file"):
        read_accelerogram(tmp_path / "record.txt", "g")


@pytest.mark.parametrize(
    ("values", "doubt"),
    [
        ([0.0, 40.0, -40.0, 0.0], "has a PGA of 4.08 g, which is unusual. Check its unit."),
        ([0.0, 0.02, -0.02, 0.0], "has a PGA of 0.00204 g, which is unusual. Check its unit."),
        ([0.0, 2.0, -1.0, 0.0], "ends at 0.67 of its PGV. Its baseline may need a correction"),
        ([0.0, 0.0], "does not move the ground."),
    ],
)
def test_doubtful_records_are_named(tmp_path: Path, values: list[float], doubt: str) -> None:
    path = written(tmp_path, "".join(f"{value}\n" for value in values))
    result = activefail("simulate", *BEARING, "--record", path, "--unit", "m/s2", "--dt", "0.05")
    assert result.code == 0
    assert f"note: record {doubt}" in result.err


def test_a_usual_record_is_not_doubted(tmp_path: Path) -> None:
    assert doubts(read_accelerogram(written(tmp_path, "0\n1\n-1\n1\n-1\n0\n"), "m/s2", 0.05)) == []
    assert (
        "has an interval of 0.5 s between samples, which is unusual."
        in doubts(read_accelerogram(written(tmp_path, "0\n1\n-1\n1\n-1\n0\n"), "m/s2", 0.5))[0]
    )
    # Its velocity is always zero at the samples.
    assert doubts(read_accelerogram(written(tmp_path, "1\n-1\n1\n-1\n"), "m/s2", 0.05)) == []


BEARING = (
    "--t-b", "4", "--mu", "0.06", "--d-tot", "0.65", "--h-sl-ratio", "0.6", "--h-rim-ratio", "0.1", "--p", "45",
    "--k", "2e9",
)  # fmt: skip


def test_the_command_simulates_a_record(tmp_path: Path) -> None:
    t = np.arange(0.0, 6.0, 0.01)
    path = written(tmp_path, "".join(f"{a:.6f}\n" for a in 0.3 * np.sin(2.0 * t) * np.exp(-((t - 3.0) ** 2))))
    options = (*BEARING, "--record", path, "--dt", "0.01", "--unit", "g")
    result = activefail("simulate", *options, "--scale", "0.5", "--plot", tmp_path / "motion.svg")
    assert result.code == 0, result.err
    assert "record     record: 600 samples of 0.01 s, PGA 0.1" in result.out
    assert "outcome    no_impact" in result.out
    assert "record" in (tmp_path / "motion.svg").read_text()
    assert (
        activefail("simulate", *options, "--scale", "6").out.splitlines()[1]
        == "outcome    failure (loss_of_confinement)"
    )
    up = tmp_path / "up.txt"
    up.write_text("0.2\n-0.4\n" * 300)
    risen = activefail("simulate", *options, "--vertical", up)
    assert "vertical   PGA 0.4 g" in risen.out
    assert risen.out.splitlines()[2:] != activefail("simulate", *options).out.splitlines()[1:]
    up.write_text("0 0.2\n0.02 -0.4\n")
    refused(
        activefail("simulate", *options[:-4], "--unit", "g", "--dt", "0.01", "--vertical", up),
        "up.txt: dt: the times have an interval of 0.02 s, got 0.01 s",
    )
    refused(activefail("simulate", *BEARING, "--vertical", up), "--vertical requires --record")
    refused(activefail("simulate", *options, "--t-p", "1"), "--record cannot be combined with --t-p")
    refused(
        activefail("simulate", *options[:-2]), "record.txt: unit: the header states none, so it is required (--unit"
    )
    refused(activefail("simulate", *BEARING, "--scale", "2"), "--scale requires --record")
    refused(
        activefail("simulate", "--t-b", "4", "--record", path, "--unit", "g", "--dt", "0.01"), "all seven variables"
    )
