"""The commands of the wing, with the example that each one's help ends with."""

from collections.abc import Callable

from activefail.cli.analyses import command_of
from activefail.seismic.analyses import hazard, ida
from activefail.seismic.paper.command import paper
from activefail.seismic.simulate import simulate

COMMANDS: dict[Callable[..., None], str] = {
    simulate: "--t-b 4 --mu 0.06 --d-tot 0.6 --h-sl-ratio 0.6 --h-rim-ratio 0.1 --p 45 --k 2e9 --t-p 2.5 --a-p 0.5",
    **command_of(hazard),
    **command_of(ida),
    paper: "--draws 4 --fresh 1000",
}
