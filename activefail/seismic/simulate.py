"""`activefail simulate`: one bearing or a table."""

import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from activefail.cli.common import AsJson, name_of, print_json, table_input, table_output
from activefail.errors import InputError, naming
from activefail.record.layout import check_output
from activefail.run.analysis import Option, option
from activefail.seismic.analyses import MODEL, TOLERANCE
from activefail.session.display import progress_bar
from activefail.text.files import check_file, writing_to
from activefail.visible import visible

if TYPE_CHECKING:
    from activefail.seismic.bearing import Accelerogram, Model, Response, Tolerance


DESIGN: Any = option(
    None,
    "A design, as the variables of Table 1.",
    "builtins:dict",
    parts={
        "t_b": Option(None, "Bearing period T_b [s].", float),
        "mu": Option(None, "Friction coefficient.", float),
        "d_tot": Option(None, "Displacement capacity D_tot [m].", float),
        "h_sl_ratio": Option(None, "Slider height over slider diameter.", float),
        "h_rim_ratio": Option(None, "Rim height over slider diameter.", float),
        "p": Option(None, "Pressure on the slider [MPa].", float),
        "k": Option(None, "Contact stiffness [N/m^1.5].", float),
        "t_p": Option(None, "Pulse period T_p [s].", float),
        "a_p": Option(None, "Pulse amplitude A_p [g].", float),
    },
)
OF_PULSE = ("--t-p", "--a-p")


def simulate(
    design: dict[str, float | None] = DESIGN,
    record: Path | None = option(None, "Ground-motion record in place of the pulse (docs/records.md).", Path),
    unit: str | None = option(None, "Unit of the record, if its header states none: g, m/s2, cm/s2 or mm/s2."),
    scale: float | None = option(None, "Factor on the record; 1 by default.", float),
    dt: float | None = option(None, "Time between the samples of a record without times [s].", float),
    vertical: Path | None = option(None, "Vertical component of the record, in its unit.", Path),
    csv: Path | None = option(
        None, "Table of designs: T_b,mu,D_tot,h_sl_ratio,h_rim_ratio,p,k,T_p,A_p; - is standard input.", Path
    ),
    out: Path | None = option(None, "Table to write, with --csv; - is standard output.", Path),
    plot: Path | None = option(None, "Plot the response (.png, .svg or .pdf).", Path),
    animate: Path | None = option(None, "Animate the bearing (.gif).", Path),
    as_json: AsJson = False,
    model: "Model" = MODEL,
    tolerance: "Tolerance" = TOLERANCE,
) -> None:
    """Simulate one bearing, or a table of designs.

    The ground motion is a pulse or a record.
    """
    for name, path in {"--plot": plot, "--animate": animate}.items():
        check_output(name, path)
    values = {f"--{name.replace('_', '-')}": value for name, value in design.items()}
    motion = None
    if record is not None:
        for name, value in {**{one: values.pop(one) for one in OF_PULSE}, "--csv": csv}.items():
            if value is not None:
                raise InputError(f"--record cannot be combined with {name}.")
        motion = _read_record(record, unit, scale, dt, vertical)
    else:
        for name, of_record in {"--unit": unit, "--scale": scale, "--dt": dt, "--vertical": vertical}.items():
            if of_record is not None:
                raise InputError(f"{name} requires --record.")
    present = {name: value for name, value in values.items() if value is not None}
    if csv is not None:
        for_one = {"--plot": plot, "--animate": animate, "--json": as_json}
        if single := [*present, *(name for name, value in for_one.items() if value)]:
            raise InputError(f"--csv cannot be combined with {single[0]}, which is for one design.")
        _simulate_table(csv, out, model, tolerance)
        return
    _check_single(values, out)
    _simulate_one(list(present.values()), motion, model, tolerance, plot, animate, as_json)


def _read_record(
    path: Path, unit: str | None, scale: float | None, dt: float | None, vertical: Path | None
) -> "Accelerogram":
    from activefail.seismic.motions.accelerogram_files import read_accelerogram

    accelerogram = read_accelerogram(path, unit, dt)
    if vertical is not None:
        component = read_accelerogram(vertical, unit, dt)
        with naming(f"{visible(str(vertical))}: "):
            accelerogram = accelerogram.with_vertical(component)
    return accelerogram if scale is None else accelerogram.scaled(scale)


def _check_single(design: Mapping[str, float | None], out: Path | None) -> None:
    missing = [option for option, value in design.items() if value is None]
    if missing:
        number = {7: "seven", 9: "nine"}[len(design)]
        # Records and tables exclude each other.
        advice = " (Or use --csv and --out.)" if len(design) == 9 else ""
        raise InputError(f"A design needs all {number} variables; missing: {', '.join(missing)}.{advice}")
    if out is not None:
        raise InputError("--out requires --csv; for one design use --plot or --animate.")


def _simulate_one(
    design: list[float],
    record: "Accelerogram | None",
    model: "Model",
    tolerance: "Tolerance",
    plot: Path | None,
    animate: Path | None,
    as_json: bool,
) -> None:
    from activefail.seismic.bearing.design import TABLE_1, Bearing, Pulse, outside_table_1
    from activefail.seismic.bearing.motion import record_lines, response_lines
    from activefail.seismic.bearing.simulation import simulate_one
    from activefail.seismic.bearing.terms import Terms
    from activefail.seismic.motions.accelerogram_files import doubts

    check_file(plot, "a plot", (".png", ".svg", ".pdf"))
    check_file(animate, "an animation", (".gif",))
    bearing = Bearing.from_row(design, model.slider_diameter)
    motion = record if record is not None else Pulse.from_table(*design[7:])
    # The plots show the motion beyond the moment that decides the outcome.
    response = simulate_one(bearing, motion, model, tolerance, to_the_end=True)
    terms = Terms.of(dict(zip(TABLE_1.names, design, strict=False)), model)
    if as_json:
        print_json({**_as_json(response), "terms": None if terms is None else terms.as_json()})
    else:
        lines = [] if record is None else record_lines(record)
        lines += response_lines(response)
        lines += [] if terms is None else [f"{title:<10} {text}" for title, text in terms.lines()]
        print("\n".join(map(visible, lines)))
    notes = [] if record is None else doubts(record)
    for note in [*notes, *outside_table_1(design)]:
        print(f"note: {visible(note)}", file=sys.stderr)
    if plot is not None:
        from activefail.pages.figures.style import save_figure
        from activefail.seismic.figures.motion import plot_response

        with writing_to(plot):
            save_figure(plot_response(response), plot)
        _print_file("plot", plot, as_json)
    if animate is not None:
        from activefail.seismic.figures.animation import save_animation

        with writing_to(animate), progress_bar("drawing") as begin:
            save_animation(response, animate, begin=begin)
        _print_file("animation", animate, as_json)
    if response.outcome_name == "numerical_failure":
        raise typer.Exit(1)


def _as_json(response: "Response") -> dict[str, object]:
    """The outcome of a simulation as JSON values; a margin that does not exist is NaN."""
    return {
        "outcome": response.outcome_name,
        "cause": response.cause_name,
        "margins": response.margins._asdict(),
        "statistics": response.statistics._asdict(),
    }


def _print_file(title: str, path: Path, as_json: bool) -> None:
    """Print the name of a file that was written; with JSON to the error stream."""
    print(f"{title:<10} {visible(str(path))}", file=sys.stderr if as_json else sys.stdout)


def _simulate_table(source: Path, target: Path | None, model: "Model", tolerance: "Tolerance") -> None:
    from activefail.seismic.tables import simulate_table

    if target is None:
        raise InputError("--csv requires --out FILE for the results.")
    start = time.monotonic()
    with table_output("--out", target) as table:
        with progress_bar("simulating") as begin:
            counts = simulate_table(table_input(source), table, model, tolerance, begin)
        total = sum(counts.values())
        print(
            f"{total} designs in {time.monotonic() - start:.1f} s: "
            + ", ".join(f"{n} {name}" for name, n in counts.items())
        )
        print(f"written to {name_of(target)}")
