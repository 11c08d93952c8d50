"""Variables that may be free in a design under a hazard."""

import pytest

from activefail.campaign.question import Question
from activefail.errors import InputError
from activefail.space.distributions import moments
from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace


def test_variables_of_the_pulse_cannot_be_free_under_a_hazard() -> None:
    mean, sd = moments("lognormal", None, None, {"median": 1.0, "dispersion": 0.4})
    pulses = DesignSpace(
        (
            Parameter("T_p", 0.1, 9.0, "s", "lognormal", mean, sd),
            Parameter("PGV", 0.01, 9.0, "m/s", "lognormal", mean, sd),
        )
    )
    question = Question("made", ("D_tot", "T_p", "A_p"), pulses, {"D_tot": 0.6})
    with pytest.raises(InputError, match="A_p: cannot have a value, because it follows from PGV"):
        question.at({"A_p": 0.5})
