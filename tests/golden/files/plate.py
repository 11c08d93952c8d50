"""A plate that holds, yields or breaks, in closed form: the custom simulator of the golden outputs."""

import csv
import math
import sys


def run(design):
    """Outcome and margins of a design."""
    if design.get("load", 0.0) > 9.5 and design["stiffness"] < 1.0:
        raise ArithmeticError("the solver diverged")
    stress = design["load"] * design.get("span", 2.5) / (1.0 + math.sqrt(design["stiffness"]))
    reserve = design["strength"] - 0.5 * stress
    outcome = "holds" if reserve > 0.5 else "yields" if reserve > 0.0 else "breaks"
    return {"outcome": outcome, "margins": {"reserve": reserve}}


def branches(design):
    """The limit state of a series system with k = 7 (Waarts 2000); below zero at failure."""
    x, y = design["x"], design["y"]
    bent = 3.0 + 0.1 * (x - y) ** 2
    ends = (bent - (x + y) / 2**0.5, bent + (x + y) / 2**0.5, x - y + 7 / 2**0.5, y - x + 7 / 2**0.5)
    return {"outcome": "fails" if min(ends) < 0.0 else "safe", "margins": {"g": min(ends)}}


if __name__ == "__main__":  # answers a table of designs, as a program elsewhere does
    with open(sys.argv[1], newline="") as asked:
        rows = list(csv.DictReader(asked))
    shift = float(sys.argv[3]) if len(sys.argv) > 3 else 0.0
    with open(sys.argv[2], "w", newline="") as told:
        table = csv.writer(told)
        table.writerow(["id", "outcome", "reserve"])
        for row in rows:
            design = {name: float(cell) for name, cell in row.items() if name in ("load", "stiffness", "strength")}
            design["strength"] += shift
            try:
                result = run(design)
            except ArithmeticError:
                table.writerow([row["id"], "numerical_failure", ""])
                continue
            table.writerow([row["id"], result["outcome"], repr(result["margins"]["reserve"])])
