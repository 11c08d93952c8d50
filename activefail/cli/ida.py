"""`activefail ida`: at which intensity of each record of a set a bearing fails."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Annotated

import typer

from activefail.cli.common import (
    AsJson,
    ExecutorName,
    FrictionVelocity,
    LossOfConfinement,
    RelativeTolerance,
    Restitution,
    RestitutionCoefficient,
    Scheduler,
    SliderDensity,
    SliderDiameter,
    Workers,
    make_executor,
    opened_run,
    print_json,
)
from activefail.display import progress_bar
from activefail.errors import InputError
from activefail.files import writing_to
from activefail.interrupts import INTERRUPTED
from activefail.record.layout import check_output
from activefail.visible import visible


def ida(
    records: Annotated[
        Path,
        typer.Option(
            help="Folder of records (docs/records.md); or farfield, nearfield, nearfield-pulse or nearfield-no-pulse "
            "of FEMA P695.",
            show_default=False,
        ),
    ],
    bearing: Annotated[
        Path,
        typer.Option(
            help="TOML file with the bearing: T_b, mu, D_tot, h_sl_ratio, h_rim_ratio, p, k. With --simulator: the "
            "campaign's variables.",
            show_default=False,
        ),
    ],
    scale_to: Annotated[
        str,
        typer.Option(
            help="Intensity of the levels: factor, pga [g], pgv [m/s], sa:T [g] at a period [s], or p695, one factor "
            "for all records, by their S_T(T_b) [g]."
        ),
    ] = "pgv",
    to: Annotated[
        float | None,
        typer.Option(
            help="Highest level. Default: 8 (factor), 3 g (pga), 4 m/s (pgv), 2 g (sa), 12 S_NRT (p695).",
            show_default=False,
        ),
    ] = None,
    outcome: Annotated[
        str | None,
        typer.Option(
            help="Outcome that is sought, or a worse one: failure, impact, or one of the campaign's. Default: the "
            "most severe.",
            show_default=False,
        ),
    ] = None,
    unit: Annotated[
        str | None, typer.Option(help="Unit of records without one: g, m/s2 or cm/s2.", show_default=False)
    ] = None,
    dt: Annotated[float | None, typer.Option(help="Interval of records without times [s].", show_default=False)] = None,
    mce: Annotated[
        float | None,
        typer.Option(
            help="Intensity of the maximum considered earthquake; adds the collapse margin ratio of FEMA P695.",
            show_default=False,
        ),
    ] = None,
    ssf: Annotated[
        float | None,
        typer.Option(help="Spectral shape factor of FEMA P695, with --mce; 1 by default.", show_default=False),
    ] = None,
    sdc: Annotated[
        str | None,
        typer.Option(
            help="Seismic design category (dmax, dmin, cmax, cmin, bmax, bmin), to compute the shape factor and --mce; "
            "requires --scale-to p695.",
            show_default=False,
        ),
    ] = None,
    ductility: Annotated[
        float | None,
        typer.Option(help="Period-based ductility of FEMA P695, for --sdc and --ratings.", show_default=False),
    ] = None,
    beta_total: Annotated[
        float | None, typer.Option(help="Total dispersion β, with --mce; 0.5 by default.", show_default=False)
    ] = None,
    ratings: Annotated[
        str | None,
        typer.Option(
            help="Ratings A to D of design requirements, test data and model, such as B,B,C, to compute β.",
            show_default=False,
        ),
    ] = None,
    vertical: Annotated[
        bool,
        typer.Option("--vertical", help="Use the vertical components that records.csv names (docs/records.md)."),
    ] = False,
    pulses: Annotated[bool, typer.Option("--pulses", help="Compare each record with the pulse nearest to it.")] = False,
    campaign: Annotated[
        Path | None,
        typer.Option(
            help="Run folder of a campaign under pulses: with --pulses, its classifier predicts each level.",
            show_default=False,
        ),
    ] = None,
    simulator: Annotated[
        Path | None,
        typer.Option(
            help="Campaign file under records, such as building_records, whose simulator replaces the bearing model; "
            "activefail executes its code.",
            metavar="CAMPAIGN.toml",
            show_default=False,
        ),
    ] = None,
    slider_diameter: SliderDiameter = 0.30,
    restitution_coefficient: RestitutionCoefficient = 0.65,
    slider_density: SliderDensity = 7850.0,
    loss_of_confinement: LossOfConfinement = True,
    restitution: Restitution = "pairwise",
    friction_velocity: FrictionVelocity = 1e-3,
    tolerance: RelativeTolerance = 1e-4,
    workers: Workers = None,
    executor: ExecutorName = "local",
    scheduler: Scheduler = None,
    as_json: AsJson = False,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for ida.json, ida.csv, ida.png, ida.svg, and the simulations, so that the same command "
            "continues after an interruption.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Find the intensity at which a bearing fails, for each record.

    The intensities give a fragility curve.
    """
    from activefail.accelerogram_sets import read_record_set
    from activefail.bearing.design import Model, Tolerance, outside_table_1
    from activefail.risk.ida import calculation
    from activefail.risk.ida.bearing_file import read_bearing
    from activefail.risk.ida.intensity import Intensity
    from activefail.risk.ida.p695 import MarginRequest
    from activefail.risk.ida.simulations import campaign_under_records

    check_output("--out", out)
    if campaign is not None and not pulses:
        raise InputError(
            "--campaign requires --pulses: a campaign's classifier predicts outcomes under pulses, not under records."
        )
    if out is not None and out.resolve() == records.resolve():
        raise InputError(f"--out: must differ from --records, got {visible(str(out))}.")
    model = Model(
        slider_diameter=slider_diameter,
        restitution_coefficient=restitution_coefficient,
        restitution=restitution,
        slider_density=slider_density,
        friction_velocity=friction_velocity,
        loss_of_confinement=loss_of_confinement,
    )
    integration, intensity = Tolerance(relative=tolerance), Intensity.of(scale_to)
    margin = MarginRequest(mce=mce, ssf=ssf, sdc=sdc, ductility=ductility, beta_total=beta_total, ratings=ratings)
    if simulator is None:
        if executor != "local" or scheduler is not None:
            raise InputError("--executor and --scheduler require --simulator; the bearing model runs in threads.")
        row = read_bearing(bearing, model)
        read = read_record_set(records, unit, dt, vertical)
        with (
            _interruptible(out),
            nullcontext() if campaign is None else opened_run(campaign) as run,
            progress_bar("simulating") as begin,
        ):
            for note in outside_table_1(row.tolist()):
                print(f"note: {note}", file=sys.stderr)
            findings = calculation.ida(
                row, read, intensity, outcome, to, margin, pulses, run, model, integration, workers, begin, out
            )
    else:
        if vertical or pulses:
            raise InputError(f"--simulator cannot be combined with {'--vertical' if vertical else '--pulses'}.")
        if (model, integration) != (Model(), Tolerance()):
            raise InputError(
                "--simulator cannot be combined with options of the bearing model or --tolerance, which the campaign's "
                "code sets."
            )
        if intensity.kind != "pgv":
            raise InputError(f"--scale-to: must be pgv with --simulator, got {visible(scale_to)!r}.")
        asked = campaign_under_records(simulator, bearing, read_record_set(records, unit, dt))
        with (
            _interruptible(out),
            make_executor(asked.campaign, workers, executor, scheduler) as pool,
            progress_bar("simulating") as begin,
        ):
            findings = calculation.ida_of_campaign(asked, outcome, to, margin, None, pool, begin, out)
    if out is not None:
        from activefail.report.ida import write_ida

        with writing_to(out):
            write_ida(findings, out)
    if as_json:
        print_json(findings.as_json())
        return
    for title, text in findings.lines:
        print(f"{title:<11} {visible(text)}")
    for note in findings.notes:
        print(f"note: {visible(note)}")
    if out is not None:
        print(f"written     {visible(str(out))}: ida.json, ida.csv, ida.png, ida.svg")


@contextmanager
def _interruptible(out: Path | None) -> Iterator[None]:
    """Say after Ctrl-C what is kept."""
    try:
        yield
    except KeyboardInterrupt:
        how = "nothing is kept without --out" if out is None else "the same command continues"
        print(f"activefail: stopped; {how}", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None
