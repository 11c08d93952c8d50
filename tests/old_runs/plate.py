"""The custom simulator of the old run folders; its source must stay as it is, or they warn of a change."""


def run(design):
    stress = design["load"] * design["span"] / (1.0 + design["stiffness"] ** 0.5)
    reserve = design["strength"] - stress / 2.0
    outcome = "holds" if reserve > 0.5 else "yields" if reserve > 0.0 else "breaks"
    return {"outcome": outcome, "margins": {"reserve": reserve}}
