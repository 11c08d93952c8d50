"""Reads the bearing of an analysis from a file: T_b, mu, D_tot, h_sl_ratio, h_rim_ratio, p, k."""

from pathlib import Path

import numpy as np

from activefail.bearing.design import TABLE_1, Bearing, Model
from activefail.campaign.question import read_fixed
from activefail.errors import InputError
from activefail.space import Array
from activefail.visible import visible


def read_bearing(file: Path, model: Model) -> Array:
    """The bearing of a file, (7,), in the units of Table 1.

    Raises:
        InputError: if a value is missing, is not one of a bearing, or breaks a rule.
    """
    values, names = read_fixed(file, TABLE_1), TABLE_1.names[:7]
    for name in values:
        if name not in names:
            raise InputError(
                f"{visible(str(file))}: {name}: belongs to a pulse; leave it out, because the records are the "
                "ground motion."
            )
    if missing := [name for name in names if name not in values]:
        raise InputError(f"{visible(str(file))}: requires {', '.join(missing)}.")
    row = [values[name] for name in names]
    try:
        Bearing.from_row(row, model.slider_diameter)
    except InputError as error:
        raise InputError(f"{visible(str(file))}: {error}") from None
    return np.array(row)
