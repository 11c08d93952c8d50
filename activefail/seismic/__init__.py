"""Bearings, ground motions and hazards: a plug-in that ships with activefail."""

from activefail.seismic import bearing

COMMANDS = "activefail.seismic.commands:COMMANDS"

FEATURES = {
    "paper": "activefail.seismic.features:of_paper",
    "sliding": "activefail.seismic.features:of_sliding",
    "collision": "activefail.seismic.features:of_collision",
}
"""Features of a bearing: the paper's six, those of the sliding block, and those of the reduced collision model."""

SIMULATORS = {"dfp": "activefail.seismic.settings:BearingSettings"}
"""The double friction pendulum bearing, by its settings (`activefail.campaign.named.NamedSettings`)."""

DEFAULTS = {"simulator": "dfp", "features": "paper"}
"""The simulator of a campaign file that names none, and its features."""

FREE = {"D_tot": ("T_b", "mu")}
"""What a design makes small if it names nothing, with the first variables of its chart."""

SETS = {"motions": "activefail.seismic.motions.motions:Motions"}
"""The ground motions of a variable with a set of records."""

LIBRARIES = {"numba": "compiles the bearing"}
"""Packages whose versions a campaign's results depend on."""

PROVENANCE = {
    "processor": "activefail.seismic.diagnosis:processor",
    "processor_features": "activefail.seismic.diagnosis:processor_features",
}
"""What else they depend on: the processor for which numba compiles."""

EXTRAS = {"records": "the records of FEMA P695 for `activefail ida`"}
"""Extras for users."""

FACTS = {"kernels": "activefail.seismic.diagnosis:kernels"}
SELF_TESTS = {"simulator": "activefail.seismic.diagnosis:simulator"}
"""What `activefail doctor` says of the bearing."""

NAMES = {
    **{name: f"activefail.seismic.bearing:{name}" for name in bearing.__all__},
    "MarginRequest": "activefail.seismic.ida.p695:MarginRequest",
    "RecordSet": "activefail.seismic.motions.accelerogram_sets:RecordSet",
    "SetRecord": "activefail.seismic.motions.accelerogram_sets:SetRecord",
    "hazard": "activefail.seismic.analyses:hazard",
    "ida": "activefail.seismic.analyses:ida",
    "read_accelerogram": "activefail.seismic.motions.accelerogram_files:read_accelerogram",
    "read_record_set": "activefail.seismic.motions.accelerogram_sets:read_record_set",
}
"""Names of `import activefail`."""

PACKAGES = {"bearing": "activefail.seismic.bearing"}
"""What users' simulators import as `activefail.bearing`."""

PLANES = {"paper": "activefail.seismic.figures.feature_planes:coordinates"}
"""Planes of a report: those of the paper's features."""

VIEWS = {"dfp": "activefail.seismic.views.bearing:BearingView"}
"""How simulated bearings are shown."""

FIGURES = {"pulses": "activefail.seismic.figures.hazard:plot_pulses"}
"""The figure of a deaggregation."""

DERIVED = {"PGV": "activefail.seismic.hazard.velocity:VELOCITY"}
"""The peak ground velocity of a pulse, in place of its amplitude."""

QUESTIONS = {"hazard": "activefail.seismic.hazard.hazard:Hazard"}
"""Kinds of question files: the pulses of a site."""

CURVES = {
    "pelicun.csv": "activefail.seismic.exports:pelicun",
    "openquake.xml": "activefail.seismic.exports:openquake",
}
"""Fragility curves for other programs, by file: functions of a ladder and the curves by outcome."""

FORMULAS = {"lateral_force_over_weight": "activefail.seismic.bearing.terms:lateral_force"}
"""Numbers of a design, beside those of its simulator's terms."""

EXPLORER_PAGES = {"design": "activefail.seismic.explorer:design_page"}
"""Pages of the explorer, by path: functions of a design space that give a title and what makes the page, or None."""
