"""Bearings, ground motions and hazards: a plug-in that ships with activefail."""

COMMANDS = "activefail.seismic.commands:COMMANDS"

FEATURES = {
    "paper": "activefail.seismic.features:of_paper",
    "sliding": "activefail.seismic.features:of_sliding",
    "collision": "activefail.seismic.features:of_collision",
}

DERIVED = {"PGV": "activefail.seismic.hazard.velocity:VELOCITY"}
"""The peak ground velocity of a pulse, in place of its amplitude."""

QUESTIONS = {"hazard": "activefail.seismic.hazard.hazard:Hazard"}
"""Kinds of question files: the pulses of a site."""

FORMULAS = {"lateral_force_over_weight": "activefail.seismic.bearing.terms:lateral_force"}
"""Numbers of a design, beside those of its simulator's terms."""

EXPLORER_PAGES = {"design": "activefail.seismic.explorer:design_page"}
"""Pages of the explorer, by path: functions of a design space that give a title and what makes the page, or None."""

PLANES = {"paper": "activefail.seismic.figures.feature_planes:coordinates"}

VIEWS = {"dfp": "activefail.seismic.views.bearing:BearingView"}

FIGURES = {"pulses": "activefail.seismic.figures.hazard:plot_pulses"}
