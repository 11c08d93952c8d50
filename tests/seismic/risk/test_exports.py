"""Files of fragility curves for other programs, read back as these programs do."""

import csv
import io
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.special import ndtr

from activefail.analyses.fragility.curve import Ladder
from activefail.seismic.exports import multilinear, openquake_model, pelicun_table
from activefail.space.space import Array

LADDER = Ladder("PGV", "m/s", 10.0 ** (np.arange(-24, 17) / 24.0), is_log=True)


def lognormal(levels: Array, median: float = 1.2, beta: float = 0.4) -> Array:
    return np.asarray(ndtr(np.log(levels / median) / beta))


PROBABILITY = lognormal(LADDER.levels)


def points(theta: str) -> tuple[Array, Array]:
    """The points of a multilinear CDF, as pelicun reads and checks them, after its rewriting with six digits."""
    x, y = (np.array([float(f"{float(value):g}") for value in part.split(",")]) for part in theta.split("|"))
    assert (y[0], y[-1]) == (0.0, 1.0)
    assert not np.isclose(np.diff(x), 0.0).any()
    assert not np.isclose(np.diff(y), 0.0).any()
    assert (np.diff(x) > 0.0).all()
    assert (np.diff(y) > 0.0).all()
    return x, y


@pytest.mark.parametrize(
    "probability",
    [
        PROBABILITY,
        0.7 * PROBABILITY,
        np.where(LADDER.levels < 1.0, 0.0, 1.0),
        np.where(LADDER.levels > 0.3, PROBABILITY, 0.05),
        np.zeros(len(LADDER.levels)),
        np.ones(len(LADDER.levels)),
    ],
)
def test_pelicun_reads_the_curve_back(probability: Array) -> None:
    x, y = points(multilinear(LADDER, probability))
    assert np.interp(LADDER.levels, x, y) == pytest.approx(np.maximum.accumulate(probability), abs=1e-4)


def test_the_tables_of_both_programs_have_a_limit_state_for_each_outcome() -> None:
    curves = {"impact": lognormal(LADDER.levels, 0.8), "failure": PROBABILITY}
    (row,) = csv.DictReader(io.StringIO(pelicun_table(LADDER, curves, "bearing")))
    assert (row["ID"], row["Demand-Type"], row["Demand-Unit"]) == ("bearing", "Peak Ground Velocity", "mps")
    assert row["LS1-Family"] == row["LS2-Family"] == "multilinear_CDF"
    for state in ("LS1", "LS2"):
        points(row[f"{state}-Theta_0"])
    name = "{http://openquake.org/xmlns/nrml/0.5}"
    root = ElementTree.fromstring(openquake_model(LADDER, curves, "bearing"))
    model = root.find(f"{name}fragilityModel")
    assert model is not None
    assert model.get("lossCategory") == "structural"
    assert model.findtext(f"{name}limitStates") == "impact failure"
    function = model.find(f"{name}fragilityFunction")
    assert function is not None
    assert (function.get("id"), function.get("format")) == ("bearing", "discrete")
    levels = function.find(f"{name}imls")
    assert levels is not None
    assert levels.get("imt") == "PGV"
    # OpenQuake's velocities are in cm/s.
    assert np.array(str(levels.text).split(), float) == pytest.approx(100.0 * LADDER.levels, rel=1e-5)
    shares = {poes.get("ls"): np.array(str(poes.text).split(), float) for poes in function.findall(f"{name}poes")}
    assert shares["failure"] == pytest.approx(PROBABILITY, abs=1e-5)
    assert shares["impact"] == pytest.approx(curves["impact"], abs=1e-5)
