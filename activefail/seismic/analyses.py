"""The analyses of one bearing, or of a site: incremental dynamic analysis, and what a hazard file says."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from activefail.errors import InputError, naming
from activefail.run.analyses import EXECUTOR, FIXED, SCHEDULER, WORKERS
from activefail.run.analysis import REQUIRED, Option, analysis, option
from activefail.seismic.motions.measures import INTENSITIES
from activefail.session.arguments import executor_named
from activefail.session.session import Session, check_can_be_asked, local_executor
from activefail.text.files import path_of
from activefail.text.progress import Begin, Stage, silent, uncounted

if TYPE_CHECKING:
    from collections.abc import Mapping

    from activefail.execution.executor import AsynchronousExecutor
    from activefail.seismic.bearing.design import Model, Tolerance
    from activefail.seismic.hazard.hazard import Hazard
    from activefail.seismic.hazard.summary import HazardSummary
    from activefail.seismic.ida.findings import IdaFindings
    from activefail.seismic.ida.p695 import MarginRequest
    from activefail.seismic.ida.simulations import Values
    from activefail.seismic.motions.accelerogram_sets import RecordSet
    from activefail.seismic.motions.intensity import Intensity

MODEL: Any = Option(
    None,
    "Choices of the bearing model.",
    "activefail.seismic.bearing.design:Model",
    parts={
        "slider_diameter": Option(0.30, "Slider diameter D_sl [m].", float),
        "restitution_coefficient": Option(0.65, "Coefficient of restitution of the contacts.", float),
        "slider_density": Option(7850.0, "Density of the slider [kg/m³].", float),
        "loss_of_confinement": Option(True, "Count the bearing as failed once no rim restrains the slider.", bool),
        "restitution": Option("pairwise", "Mass that sets the contact damping: pairwise or assembly."),
        "friction_velocity": Option(1e-3, "Velocity over which friction is regularised [m/s].", float),
        "rim": Option("rigid", "Type of the rims: rigid, breaking, yielding or none."),
        "rim_strength": Option(None, "Force at which a rim breaks or yields, over the weight.", float),
        "rim_deformation": Option(None, "Plastic deformation at which a yielding rim breaks [m].", float),
    },
)
TOLERANCE: Any = Option(
    None,
    "Accuracy of the integration.",
    "activefail.seismic.bearing.design:Tolerance",
    parts={"relative": Option(1e-4, "Relative tolerance of the integration.", float, names=("--tolerance",))},
)
MARGIN: Any = Option(
    None,
    "Collapse margin of FEMA P695.",
    "activefail.seismic.ida.p695:MarginRequest",
    parts={
        "mce": Option(
            None, "Intensity of the maximum considered earthquake; adds the collapse margin ratio of FEMA P695.", float
        ),
        "ssf": Option(None, "Spectral shape factor of FEMA P695, with --mce; 1 by default.", float),
        "sdc": Option(
            None,
            "Seismic design category (dmax, dmin, cmax, cmin, bmax, bmin), to compute the shape factor and --mce; "
            "requires --scale-to p695.",
        ),
        "ductility": Option(None, "Period-based ductility of FEMA P695, for --sdc and --ratings.", float),
        "beta_total": Option(None, "Total dispersion β, with --mce; 0.5 by default.", float),
        "ratings": Option(
            None, "Ratings A to D of design requirements, test data and model, such as B,B,C, to compute β."
        ),
    },
)


_KINDS = ", ".join(f"{kind} {of.unit}".strip() for kind, of in INTENSITIES.items())
_HIGHEST = ", ".join(f"{of.highest:g} ({kind})" for kind, of in INTENSITIES.items())


@analysis(
    "--records farfield --bearing bearing.toml --out figures",
    writes=lambda words: not words.get("pulses"),
    counts="simulating",
    pages="Folder for the page ida.html, ida.json, ida.csv, ida.png, ida.svg, and the simulations: the same command "
    "continues.",
    writer="activefail.seismic.ida.page:write_ida",
)
def ida(
    bearing: "Values" = option(
        REQUIRED,
        "TOML file with the bearing: T_b, mu, D_tot, h_sl_ratio, h_rim_ratio, p, k. With --simulator: the campaign's "
        "variables. In Python also the values, in this order or by name.",
        Path,
    ),
    records: "RecordSet | Path | str | None" = option(
        None,
        "Folder of records (docs/records.md); or farfield, nearfield, nearfield-pulse or nearfield-no-pulse of FEMA "
        "P695. Default: those of the campaign of --simulator.",
        Path,
    ),
    scale_to: "Intensity | str | None" = option(
        None,
        f"Intensity of the levels: {_KINDS}; sa:T has a period [s]; p695 is one factor for all records, by their "
        "S_T(T_b). Default: pgv, or that to which the campaign of --simulator scales its records.",
    ),
    outcome: str | None = option(
        None,
        "Outcome that is sought, or a worse one: failure, impact, or one of the campaign's. Default: the most severe.",
    ),
    to: float | None = option(None, f"Highest level. Default: {_HIGHEST}, p695 over S_NRT.", float),
    margin: "MarginRequest | None" = MARGIN,
    pulses: bool = option(
        False, "Compare each record with the pulse nearest to it.", names=("--pulses",), bars="simulator"
    ),
    unit: str | None = option(None, "Unit of records that state none: g, m/s2, cm/s2 or mm/s2.", needs="records"),
    dt: float | None = option(None, "Interval of records without times [s].", float, needs="records"),
    vertical: bool = option(
        False,
        "Use the vertical components that records.csv names (docs/records.md).",
        names=("--vertical",),
        bars="simulator",
    ),
    simulator: Path | str | None = option(
        None,
        "Campaign file under records, such as building_records, whose simulator replaces the bearing model; activefail "
        "executes its code.",
        Path,
        metavar="CAMPAIGN.toml",
    ),
    model: "Model | None" = MODEL._replace(bars="simulator"),  # noqa: B008
    tolerance: "Tolerance | None" = TOLERANCE._replace(bars="simulator"),  # noqa: B008
    workers: int | None = WORKERS,
    where: Literal["local", "dask"] = EXECUTOR._replace(needs="simulator"),
    scheduler: str | None = SCHEDULER._replace(needs="simulator"),
    folder: Path | str | None = option(
        None, "Folder that keeps the simulations, so that the same analysis continues.", Path, with_out=True
    ),
    run: Session | None = option(
        None,
        "Run folder of a campaign under records, which simulates, says where each record begins, and keeps the "
        "simulations. With --pulses: of a campaign under pulses, whose classifier predicts each level.",
        Path,
        names=("--campaign",),
    ),
    *,
    executor: "AsynchronousExecutor | None" = None,
    stage: Stage = silent,
    begin: Begin = uncounted,
) -> "IdaFindings":
    """Find the intensity at which a bearing fails, for each record.

    The intensities give a fragility curve.
    """
    from activefail.seismic.bearing.design import Model, Tolerance
    from activefail.seismic.ida.calculation import analysis
    from activefail.seismic.ida.simulations import (
        BearingSubject,
        CampaignSubject,
        Ground,
        campaign_of,
        values_under_records,
    )
    from activefail.seismic.motions.accelerogram_sets import RecordSet, read_record_set
    from activefail.seismic.motions.intensity import Intensity

    its_run = None if pulses else run
    if its_run is not None:
        name, campaign = its_run.folder.name, its_run.campaign
        if not its_run.writes:
            raise InputError("run: must be open for writing, because the simulations join its record.")
        check_can_be_asked(its_run)
        of_others = {"simulator": simulator, "vertical": vertical, "model": model, "tolerance": tolerance}
        for given in (one for one, value in of_others.items() if value):
            raise InputError(f"{given}: cannot be combined with --campaign without --pulses.")
    elif simulator is not None:
        name, campaign = campaign_of(simulator)
    else:
        name, campaign = "", None
    ground = Ground() if campaign is None else Ground.of(campaign)
    measure = scale_to or ground.measure
    intensity = Intensity.of(measure) if isinstance(measure, str) else measure
    if campaign is not None and intensity.name != Intensity.of(ground.measure).name:
        raise InputError(f"--scale-to: must be {ground.measure} with this campaign, got {scale_to!r}.")
    records, keep = records or ground.records, None if folder is None else path_of("folder", folder)
    if records is None:
        raise InputError("--records: required, unless a campaign has a variable with a `set`.")
    if not isinstance(records, RecordSet):
        if keep is not None and keep.resolve() == Path(records).resolve():
            raise InputError(f"--out: must differ from --records, got {keep}.")
        records = read_record_set(records, unit, dt, vertical)
    about = (intensity, outcome, to, margin, pulses, run, keep, begin)
    try:
        if campaign is None:
            subject = BearingSubject.of(bearing, model or Model(), tolerance or Tolerance(), workers)
            return analysis(subject, records, *about)
        values = values_under_records(campaign, ground, bearing, records)
        if executor is not None:
            return analysis(CampaignSubject(name, campaign, ground, values, executor), records, *about)
        if its_run is not None:
            pool = local_executor(its_run, workers)
        else:
            pool = executor_named(campaign, workers, where, scheduler, stage)
        with pool:
            return analysis(CampaignSubject(name, campaign, ground, values, pool), records, *about)
    except KeyboardInterrupt:
        is_kept = keep is not None or its_run is not None
        raise KeyboardInterrupt("the same command continues" if is_kept else "nothing is kept without --out") from None


@analysis(
    "hazard.toml runs/first --out figures",
    writes=False,
    pages="Folder for the figure: hazard.png and hazard.svg.",
    writer="activefail.seismic.figures.hazard:write_hazard",
)
def hazard(
    hazard: "Hazard | Path | str" = option(
        REQUIRED, "Hazard file (docs/hazard.md).", Path, is_argument=True, metavar="FILE"
    ),
    fixed: "Mapping[str, float] | Path | str | None" = FIXED,
    run: Session | None = option(
        None,
        "Run folder; shows the share of the pulses outside its design space.",
        Path,
        is_argument=True,
        metavar="DIR",
    ),
) -> "HazardSummary":
    """Check a hazard file and show its pulses.

    With a run folder, also shows which share of the pulses lies outside the campaign's design space.
    """
    from activefail.campaign.question import values_of
    from activefail.seismic.hazard.hazard import Hazard, read_hazard
    from activefail.seismic.hazard.summary import HazardSummary

    if run is None and fixed is not None:
        raise InputError("fixed: requires a run folder, whose variables it fixes.")
    known = hazard if isinstance(hazard, Hazard) else read_hazard(path_of("hazard", hazard))
    space = None if run is None else run.space
    values = values_of(fixed, space) if space else {}
    with naming("" if known is hazard else f"{hazard}: "):
        return HazardSummary.of(known, space, values)
