"""`activefail check`: one design of a campaign, simulated twice, before hours are spent."""

import shutil
import tempfile
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from activefail.cli.common import AsJson, CampaignFile, print_json
from activefail.errors import SimulationError
from activefail.visible import visible

if TYPE_CHECKING:
    from activefail.campaign.assembly import Campaign
    from activefail.campaign.sections import OutcomeSettings
    from activefail.simulators.interface import Results


def check(campaign: CampaignFile, as_json: AsJson = False) -> None:
    """Simulate one design of a campaign twice, and show what activefail understands.

    Shows variables, simulator, outcome, margins and time. The two results must agree, unless the file says with
    `simulator.repeatable` whether they do. No run folder is created.
    """
    from activefail.run.opening import campaign_for
    from activefail.simulators.command import CommandSimulator

    folder, keeps = Path(tempfile.mkdtemp(prefix="activefail-check-")), False
    shown = []
    try:
        assembled = campaign_for(folder, campaign)
        keeps = isinstance(assembled.simulator, CommandSimulator)  # a program's files show what it did
        for title, text in chain(_understood(assembled), () if assembled.is_elsewhere else _simulated(assembled)):
            shown.append({"title": title, "text": visible(text)})
            if not as_json:
                print(f"{title:<10} {visible(text)}", flush=True)
        if as_json:
            print_json({"understood": shown})
    finally:
        if not keeps:
            shutil.rmtree(folder, ignore_errors=True)


def _understood(campaign: "Campaign") -> Iterator[tuple[str, str]]:
    """What the campaign file says, as titles and texts."""
    from activefail.simulators.command import CommandSimulator
    from activefail.simulators.function import PythonSimulator
    from activefail.space.shares import choices_with_shares, feasible_share

    simulator, space = campaign.simulator, campaign.space
    for one in space.parameters:
        if one.choices:
            yield "variable", f"{one.label}: {choices_with_shares(one)}"
            for name, numbers in one.features:
                yield "feature", f"{name} = {', '.join(f'{number:g}' for number in numbers)}"
            yield from (("note", note) for note in getattr(one.payload, "notes", ()))
            continue
        steps = "" if one.step is None else f" in steps of {one.step:g}"
        yield "variable", f"{one.label}: {one.low:g} to {one.high:g}{steps}, {one.distribution.replace('_', ' ')}"
    for constraint in space.constraints:
        yield "constraint", constraint.text
    if space.constraints:
        yield "feasible", f"{feasible_share(space)} of the variables' distribution"
    for name, value in space.fixed.items():
        yield "fixed", f"{name} = {value:g}"
    match simulator:
        case PythonSimulator():
            yield "simulator", f"the function {simulator.reference} in {simulator.code}"
        case CommandSimulator():
            yield "simulator", f"the program {simulator.command}"
            for file, names in simulator.filled.items():
                yield "template", f"{file} is filled in with {', '.join(names)}"
            if lost := simulator.unnamed:
                yield (
                    "warning",
                    f"neither the command nor a template names {', '.join(lost)}; the program must read design.json or "
                    f"$AF_{lost[0]}",
                )
        case _:
            yield "simulator", getattr(simulator, "title", "elsewhere; nothing is simulated here")
    custom = campaign.settings.simulator
    for name, text in (
        custom.margins.items() if not isinstance(custom, str) and isinstance(custom.margins, dict) else ()
    ):
        yield "margin", f"{name} = {text}"
    boundaries = ", ".join(campaign.settings.acquisition.boundaries)
    yield "outcomes", f"{', '.join(simulator.outcomes)}; sought is the boundary of {boundaries}"
    if campaign.system is not None:
        yield "margins", f"{campaign.system.text} <= 0 at {simulator.outcomes[-1]}"
    elif simulator.margins and not isinstance(custom, str):
        for place, outcome in enumerate(simulator.outcomes[1:]):
            rules = zip(campaign.margins, campaign.levels[place].tolist(), strict=True)
            yield "margins", f"{', '.join(f'{name} <= {level:g}' for name, level in rules)} at {outcome}"


def _simulated(campaign: "Campaign") -> Iterator[tuple[str, str]]:
    """The design in the middle of the space, or another if that is infeasible, simulated twice, as titles and texts.

    Raises:
        SimulationError: if a simulation fails, or the two results differ and the file does not say whether they may.
    """
    import numpy as np

    from activefail.execution.local import local_executor
    from activefail.simulators.command import CommandSimulator
    from activefail.simulators.repeats import IF_DIFFERENT, differences, in_words

    simulator, space, custom = campaign.simulator, campaign.space, campaign.settings.simulator
    X = space.from_unit(np.full((1, space.dimension), 0.5))
    is_median = bool(space.contains(X).all())
    X = X if is_median else space.random(1, np.random.default_rng(0))
    values = {name: column.item() for name, column in space.columns(X).items()}
    yield "design", ", ".join(f"{name} = {value!r}" for name, value in values.items())
    if isinstance(simulator, CommandSimulator):
        yield "folder", str(simulator.folder_of(X[0]))
    results = []
    for _ in range(2):
        with local_executor(simulator, 1, campaign.time_limit) as executor:
            results.append(executor.run(simulator, X))
        for fault in results[-1].faults.values():
            raise SimulationError(f"The simulation failed: {fault}.")
    first = in_words(simulator, results[0])
    yield from first.items()
    if campaign.contradicts(results[0])[0]:
        yield "warning", f"the outcome {first['outcome']} contradicts all margins; a margin at its level or below fails"
    elif not isinstance(custom, str) and (custom.levels_of_number or custom.system) and is_median:
        yield from (("warning", text) for text in _turned(campaign, custom, results[0]))
    seconds = max(float(one.seconds[0]) for one in results)
    budget = campaign.settings.sampling.budget
    yield (
        "time",
        f"{seconds:.3g} s; {budget} simulations, the budget, take {seconds * budget:.3g} s one by one",
    )
    if not (text := differences(simulator, results[0], results[1])):
        yield "agrees", "a second simulation of the design has the same result"
    elif isinstance(custom, str) or custom.repeatable is None:
        raise SimulationError(f"The same design has two results: {text}. {IF_DIFFERENT}")
    else:
        yield "differs", f"{text}; the file states simulator.repeatable"


def _turned(campaign: "Campaign", custom: "OutcomeSettings", result: "Results") -> Iterator[str]:
    """Where the design at the medians fails, which is rare: the margins that say so, and how to turn each."""
    severity, several = campaign.severity, len(campaign.simulator.outcomes) > 2
    levels = campaign.levels[severity - 1].tolist()
    for name, level, margin in zip(campaign.margins, levels, result.margins[0].tolist(), strict=False):
        if result.outcome[0] < severity or not margin <= level:
            continue
        text = f"-{name}" if several or not level else f"{level:g} - {name}"
        turned = f'margins = {{ {name}_margin = "{text}" }}'
        if isinstance(custom.margins, dict):
            turned = f'margins.{name} = "-({custom.margins[name]})"'
        yield (
            f"the design at the medians of the variables fails: {name} = {margin:.6g} is at most {level:g}. If it is "
            f"safe, turn the margin round: {turned}{', with the negative levels' * several}"
        )
