"""`activefail ida`: at which intensity of each record of a set a bearing fails."""

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from activefail.cli.common import (
    AsJson,
    FrictionVelocity,
    LossOfConfinement,
    RelativeTolerance,
    Restitution,
    RestitutionCoefficient,
    SliderDensity,
    SliderDiameter,
    Workers,
    opened_run,
    print_json,
)
from activefail.display import progress_bar
from activefail.errors import InputError
from activefail.files import replacing, writing_to
from activefail.record.layout import check_output
from activefail.visible import visible

if TYPE_CHECKING:
    from activefail.bearing import Model
    from activefail.risk.ida.findings import IdaFindings
    from activefail.risk.ida.predictions import Surrogate
    from activefail.space import Array


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
            help="TOML file with the bearing: T_b, mu, D_tot, h_sl_ratio, h_rim_ratio, p, k.", show_default=False
        ),
    ],
    scale_to: Annotated[
        str, typer.Option(help="Intensity of the levels: factor, pga [g], pgv [m/s], or sa:T [g] at a period [s].")
    ] = "pgv",
    to: Annotated[
        float | None,
        typer.Option(help="Highest level. Default: 8 (factor), 3 g (pga), 4 m/s (pgv), 2 g (sa).", show_default=False),
    ] = None,
    outcome: Annotated[str, typer.Option(help="Outcome that is sought: failure or impact.")] = "failure",
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
            help="Seismic design category (dmax, dmin, cmax, cmin, bmax, bmin), to compute the shape factor.",
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
    slider_diameter: SliderDiameter = 0.30,
    restitution_coefficient: RestitutionCoefficient = 0.65,
    slider_density: SliderDensity = 7850.0,
    loss_of_confinement: LossOfConfinement = True,
    restitution: Restitution = "pairwise",
    friction_velocity: FrictionVelocity = 1e-3,
    tolerance: RelativeTolerance = 1e-4,
    workers: Workers = None,
    as_json: AsJson = False,
    out: Annotated[
        Path | None, typer.Option(help="Folder for ida.json, ida.csv, ida.png and ida.svg.", show_default=False)
    ] = None,
) -> None:
    """Find the intensity at which a bearing fails, for each record.

    The intensities give a fragility curve.
    """
    from activefail.accelerogram_sets import read_record_set
    from activefail.bearing.design import Model, Tolerance, outside_table_1
    from activefail.risk.ida.findings import BISECTIONS, LEVELS, analyse
    from activefail.risk.ida.intensity import Intensity
    from activefail.risk.ida.p695 import MarginRequest

    check_output("--out", out)
    if campaign is not None and not pulses:
        raise InputError("--campaign: needs --pulses, because a campaign under pulses knows no records.")
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
    integration = Tolerance(relative=tolerance)
    intensity, row = Intensity.of(scale_to), _bearing(bearing, model)
    request = MarginRequest(mce=mce, ssf=ssf, sdc=sdc, ductility=ductility, beta_total=beta_total, ratings=ratings)
    read = read_record_set(records, unit, dt, vertical)
    options = request.options(float(row[0]), read.of_p695)
    surrogate = None if campaign is None else _surrogate(campaign, outcome, model)
    if out is not None:
        # Before the simulations, which would be lost.
        with writing_to(out):
            out.mkdir(parents=True, exist_ok=True)
    for note in outside_table_1(row.tolist()):
        print(f"note: {note}", file=sys.stderr)
    with progress_bar("simulating") as begin:
        noted = begin(len(read.records) * (LEVELS + BISECTIONS) * (2 if pulses else 1))
        found = analyse(
            row, read, intensity, outcome, to, options, pulses, surrogate, model, integration, workers, noted
        )
    if out is not None:
        _write(found, out)
    if as_json:
        print_json(found.as_json())
        return
    for title, text in found.lines:
        print(f"{title:<11} {visible(text)}")
    for note in found.notes:
        print(f"note: {visible(note)}")
    if out is not None:
        print(f"written     {visible(str(out))}: ida.json, ida.csv, ida.png, ida.svg")


def _bearing(file: Path, model: "Model") -> "Array":
    """The bearing of a file, (7,), in the units of Table 1.

    Raises:
        InputError: if a value is missing, is not one of a bearing, or breaks a rule.
    """
    import numpy as np

    from activefail.bearing.design import TABLE_1, Bearing
    from activefail.campaign.question import read_fixed

    values, names = read_fixed(file, TABLE_1), TABLE_1.names[:7]
    for name in values:
        if name not in names:
            raise InputError(
                f"{visible(str(file))}: {name}: belongs to a pulse; leave it out, because the records are the "
                "ground motion."
            )
    if missing := [name for name in names if name not in values]:
        raise InputError(f"{visible(str(file))}: needs {', '.join(missing)}.")
    row = [values[name] for name in names]
    try:
        Bearing.from_row(row, model.slider_diameter)
    except InputError as error:
        raise InputError(f"{visible(str(file))}: {error}") from None
    return np.array(row)


def _surrogate(folder: Path, outcome: str, model: "Model") -> "Surrogate":
    """The classifier of a run folder.

    Raises:
        InputError: if the folder has no campaign under pulses with this model, or the outcome is unknown.
    """
    from activefail.bearing.outcome import OUTCOMES
    from activefail.risk.ida.predictions import Surrogate

    if outcome not in OUTCOMES:
        raise InputError(f"--outcome: must be one of {', '.join(OUTCOMES[1:])}, got {outcome!r}.")
    with opened_run(folder) as run:
        if run.settings.bearing.model() != model:
            raise InputError(
                "--campaign: its [bearing] settings differ from this command's options. Give this command the same "
                "values."
            )
        return Surrogate(run.campaign, run.classifier, OUTCOMES.index(outcome))


def _write(found: "IdaFindings", out: Path) -> None:
    from activefail.csv_table import writing
    from activefail.figures.ida import plot_ida
    from activefail.figures.style import save_figure

    numbers = found.as_json()
    columns = list(numbers["records"][0])
    with writing_to(out):
        with replacing(out / "ida.json") as file:
            file.write(json.dumps(numbers, indent=2))
        with writing(out / "ida.csv", columns) as write:
            write([["" if row[name] is None else row[name] for name in columns] for row in numbers["records"]])
        figure = plot_ida(found)
        save_figure(figure, out / "ida.png")
        save_figure(figure, out / "ida.svg")
