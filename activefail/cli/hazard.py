"""`activefail hazard`: what a hazard file says."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from activefail.cli.common import AsJson, Code, Fixed, check_out, opened_run, print_json
from activefail.errors import InputError
from activefail.shares import percent
from activefail.visible import visible

if TYPE_CHECKING:
    from activefail.risk.hazard_summary import HazardSummary, Outside
    from activefail.space import DesignSpace


def hazard(
    file: Annotated[Path, typer.Argument(help="Hazard file (docs/hazard.md).", metavar="FILE", show_default=False)],
    folder: Annotated[
        Path | None,
        typer.Argument(
            help="Run folder; shows the share of the pulses outside its design space.",
            metavar="DIR",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the figure: hazard.png and hazard.svg.", show_default=False)
    ] = None,
    as_json: AsJson = False,
    fixed: Fixed = None,
    code: Code = None,
) -> None:
    """Check a hazard file and show its pulses.

    With a run folder, also shows which share of the pulses lies outside the campaign's design space.
    """
    from activefail.campaign.hazard import read_hazard
    from activefail.risk.hazard_summary import HazardSummary, Outside

    if folder is None and fixed is not None:
        raise InputError("--fixed: requires a run folder, whose variables it fixes.")
    check_out(out)
    read = read_hazard(file)
    summary, outside, space = HazardSummary.of(read), None, None
    if folder is not None:
        with opened_run(folder, code=code) as run:
            space = run.space
            try:
                outside = Outside.of(read, space, run.fixed_values(fixed))
            except InputError as error:
                raise InputError(f"{file}: {error}" if str(fixed) not in str(error) else str(error)) from None
    if out is not None:
        _draw(summary, space, out)
    if as_json:
        print_json(summary.as_json() | {"outside": outside.as_json() if outside else None})
        return
    _show(summary)
    if outside is not None:
        _show_outside(outside, ", with the added uncertainty," if read.added_dispersion or read.bias else "")
    for sentence in summary.assumptions:
        print(f"note         {visible(sentence)}")
    if out is not None:
        print(f"figure       {visible(str(out / 'hazard.png'))}, hazard.svg")


def _draw(summary: "HazardSummary", space: "DesignSpace | None", out: Path) -> None:
    from activefail.figures.hazard import plot_hazard
    from activefail.figures.style import save_png_and_svg
    from activefail.files import writing_to

    figure = plot_hazard(summary, space)
    with writing_to(out):
        out.mkdir(parents=True, exist_ok=True)
        save_png_and_svg(figure, out, "hazard")


def _show(summary: "HazardSummary") -> None:
    from activefail.risk.design.design_task import RISK_CATEGORIES

    read = summary.hazard
    settings = read.settings
    print(f"hazard       {visible(read.title)}")
    print(f"pulses       {visible(summary.source)}")
    for name, unit, low, median, high, dispersion in summary.spreads:
        quantiles = f"median {median:.3g} {unit}, 5 to 95 % {low:.3g} to {high:.3g} {unit}"
        print(f"{name:<12} {quantiles}, dispersion {dispersion:.3g}")
    print(f"correlation  {summary.correlation:.3g} between ln PGV and ln T_p")
    if (bounds := settings.properties) is not None:
        print(
            f"properties   friction × {bounds.mu_lower:g} to × {bounds.mu_upper:g}, displacement capacity × "
            f"{bounds.D_tot_lower:g}"
        )
    if (factor := settings.record_factor) is not None:
        print(
            f"records      capacity over that under pulses: bias {factor.bias:g} and dispersion {factor.dispersion:g} "
            "of the logarithm"
        )
    if (added := settings.uncertainty) is not None:
        print(
            f"uncertainty  design requirements {added.design_requirements:g}, test data {added.test_data:g}, modelling "
            f"{added.modelling:g}; together {added.total:.3g}"
        )
    for point in summary.curve:
        print(f"curve        PGV above {point.pgv:g} m/s: annual rate {point.rate:.3g}", end="")
        print(f" (return period {point.return_period:,.0f} years)")
    if summary.rate_at_median is not None:
        print(
            f"             PGV above its median: annual rate {summary.rate_at_median:.3g} (return period "
            f"{1.0 / summary.rate_at_median:,.0f} years)"
        )
    targets = ", ".join(f"{100.0 * share:g} % for risk category {name}" for name, share in RISK_CATEGORIES.items())
    print(f"targets      {targets}; probability of failure given MCE_R (ASCE 7-16)")


def _show_outside(outside: "Outside", added: str) -> None:
    share = percent(outside.total)
    print(f"outside      {share} of the pulses{added} lie outside the campaign's design space; none is clipped")
    for part in outside.parts:
        unit = f" {part.unit}" if part.unit else ""
        print(visible(f"             {part.name} {part.side} {part.bound:g}{unit}: {percent(part.share)}"))
