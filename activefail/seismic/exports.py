"""Fragility curves against the intensity of a ground motion in the formats of other programs.

pelicun: a row of a damage database in which each limit state has the family `multilinear_CDF`. Theta_0 holds the levels
and the probabilities, each separated by commas, with a bar between both. pelicun requires that both increase
strictly, that the probabilities begin at 0 and end at 1, and keeps six significant digits.

OpenQuake: a fragility model of NRML 0.5 with discrete functions. Its peak ground velocities are in cm/s.
"""

import csv
import io
import re
from collections.abc import Mapping
from xml.etree import ElementTree

import numpy as np

from activefail.analyses.fragility.curve import Ladder
from activefail.space.space import Array

_COMPONENT = "isolation_bearing"
"""The bearing in other programs."""

_NRML = "http://openquake.org/xmlns/nrml/0.5"

_DEMANDS = {"PGV": ("Peak Ground Velocity", "mps"), "A_p": ("Peak Ground Acceleration", "g")}
_MEASURES = {"PGV": ("PGV", 100.0), "A_p": ("PGA", 1.0)}
"""Name of the intensity, and its unit or the factor to it, in pelicun and in OpenQuake."""

_LEAST, _STEP = 1e-6, 2e-6
"""Least probability that is written, and least difference of two; pelicun keeps six significant digits."""


def multilinear(ladder: Ladder, probability: Array) -> str:
    """Theta_0 of a capacity: levels and probabilities that increase strictly, from 0 to 1.

    A curve that falls keeps its highest value. Beyond the last level the capacity is taken as exhausted one step later.
    Each probability is raised by up to two millionths for each level, so that none equals the one before it.
    """
    highest, levels = np.maximum.accumulate(probability), ladder.levels
    first = int((highest <= _LEAST).sum())
    last = max(first, int((highest < 1.0 - _LEAST).sum()))
    body, ratio = highest[first:last], float(levels[1] / levels[0])
    start = float(levels[first - 1]) if first else float(levels[0]) / ratio
    end = float(levels[last]) if last < len(levels) else float(levels[-1]) * ratio
    raised = body * (1.0 - (len(body) + 1) * _STEP) + _STEP * np.arange(1, len(body) + 1)
    x, y = [start, *levels[first:last], end], [0.0, *raised, 1.0]
    return "|".join(",".join(f"{value:.6g}" for value in values) for values in (x, y))


def pelicun_table(ladder: Ladder, curves: Mapping[str, Array], name: str) -> str:
    """A damage database of pelicun with one component.

    Args:
        ladder: levels of the intensity.
        curves: (n,) by outcome, the least severe first; each is a limit state.
        name: of the component.
    """
    demand, unit = _DEMANDS[ladder.name]
    header = ["ID", "Incomplete", "Demand-Type", "Demand-Unit", "Demand-Offset", "Demand-Directional"]
    row = [name, "0", demand, unit, "0", "1"]
    for number, curve in enumerate(curves.values(), start=1):
        header += [f"LS{number}-{key}" for key in ("Family", "Theta_0", "Theta_1", "DamageStateWeights")]
        row += ["multilinear_CDF", multilinear(ladder, curve), "", ""]
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([header, row])
    return text.getvalue()


def openquake_model(ladder: Ladder, curves: Mapping[str, Array], name: str) -> str:
    """A fragility model of OpenQuake with one discrete function.

    Args:
        ladder, curves, name: as for `pelicun_table`; the name is the taxonomy.
    """
    measure, factor = _MEASURES[ladder.name]
    root = ElementTree.Element("nrml", {"xmlns": _NRML})
    model = ElementTree.SubElement(
        root, "fragilityModel", {"id": "activefail", "assetCategory": "buildings", "lossCategory": "structural"}
    )
    ElementTree.SubElement(model, "description").text = "Fragility of a seismic isolation bearing, by activefail"
    states = {outcome: re.sub(r"[^A-Za-z0-9_-]", "_", outcome) for outcome in curves}
    ElementTree.SubElement(model, "limitStates").text = " ".join(states.values())
    function = ElementTree.SubElement(model, "fragilityFunction", {"id": name, "format": "discrete"})
    levels = ElementTree.SubElement(function, "imls", {"imt": measure})
    levels.text = " ".join(f"{factor * level:.6g}" for level in ladder.levels)
    for outcome, curve in curves.items():
        shares = ElementTree.SubElement(function, "poes", {"ls": states[outcome]})
        shares.text = " ".join(f"{share:.6g}" for share in curve)
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def pelicun(ladder: Ladder, curves: Mapping[str, Array]) -> str | None:
    """The damage database, of the curves of all outcomes, (n,) by outcome; None if not against such an intensity."""
    return pelicun_table(ladder, curves, _COMPONENT) if _is_of_motion(ladder) else None


def openquake(ladder: Ladder, curves: Mapping[str, Array]) -> str | None:
    """The fragility model; None as for `pelicun`."""
    return openquake_model(ladder, curves, _COMPONENT) if _is_of_motion(ladder) else None


def _is_of_motion(ladder: Ladder) -> bool:
    return ladder.name in _MEASURES and ladder.is_log
