"""Two buildings that pound: the gap that a pulse leaves between them, and what becomes of them."""


def run(design):
    reserve = 0.3 + 4.0 * design["mu"] - 0.25 * design["A_g"] * design["T_g"] ** 2
    if reserve > 0.0:
        return "no_impact"
    return "impact" if reserve > -0.4 * (design["k"] / 1e9) ** 0.2 else "failure"
