"""Bearings, ground motions and hazards: a plug-in that ships with activefail."""

COMMANDS = "activefail.seismic.commands:COMMANDS"

FEATURES = {
    "paper": "activefail.seismic.features:of_paper",
    "sliding": "activefail.seismic.features:of_sliding",
    "collision": "activefail.seismic.features:of_collision",
}

PLANES = {"paper": "activefail.seismic.figures.feature_planes:coordinates"}

VIEWS = {"dfp": "activefail.seismic.views.bearing:BearingView"}

FIGURES = {"pulses": "activefail.seismic.figures.hazard:plot_pulses"}
