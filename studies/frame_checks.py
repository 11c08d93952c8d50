"""What `frame.py --part checks` measures in OpenSees; needs openseespy and NumPy alone.

    python studies/frame_checks.py < cases.json

`cases.json` has `design`, the quantities of campaigns/frame.toml by name, and `motions`, designs with records. The
answer, on stdout, has the periods of the frame on a fixed base at three strengths, the same by an eigenvalue problem
that this file assembles, the reactions under the weight, a pushover, and the peaks under each motion.
"""

import json
import math
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "campaigns"))
import frame_model as model


def member_stiffness(E, A, inertia, L, k):
    """Of a member with rotational springs k at both ends, (6, 6) in its own axes: u, v, θ of either end.

    The springs enter by the flexibility of the two end rotations: L/(6EI) [[2, -1], [-1, 2]] + 1/k on its diagonal.
    """
    S = np.linalg.inv(L / (6.0 * E * inertia) * np.array([[2.0, -1.0], [-1.0, 2.0]]) + np.eye(2) / k)
    B = np.array([[0.0, 1.0 / L, 1.0, 0.0, -1.0 / L, 0.0], [0.0, 1.0 / L, 0.0, 0.0, -1.0 / L, 1.0]])
    along = np.array([-1.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    return B.T @ S @ B + E * A / L * np.outer(along, along)


def period_by_matrices(d, stiffness):
    """The first period on a fixed base [s], without OpenSees; the leaning column adds its mass alone."""
    columns, floors = d.bays + 1, d.storeys
    place = {(c, f): 3 * ((f - 1) * columns + c) for f in range(1, floors + 1) for c in range(columns)}
    size = 3 * columns * floors
    K, mass = np.zeros((size, size)), np.ones(size)
    E, share = d.E, model.weights(d)

    def add(first, last, A, inertia, L, upright):
        # As frame_model: the hinge has 10 times 6 E I / L, and the member 1.1 times its own stiffness in return.
        own = 6.0 * E * stiffness * inertia / L
        k = member_stiffness(E, A, (1.0 + 1.0 / model.HINGE) * inertia * stiffness, L, model.HINGE * own)
        turn = np.eye(6)
        if upright:
            turn[:2, :2] = turn[3:5, 3:5] = [[0.0, 1.0], [-1.0, 0.0]]
        k = turn.T @ k @ turn
        rows = [place[first] + i if first in place else -1 for i in range(3)] + [place[last] + i for i in range(3)]
        kept = [i for i in range(6) if rows[i] >= 0]
        at = [rows[i] for i in kept]
        K[np.ix_(at, at)] += k[np.ix_(kept, kept)]

    for floor in range(1, floors + 1):
        for bay in range(d.bays):
            add((bay, floor), (bay + 1, floor), 0.3, d.I_beam, d.bay, False)
        for column in range(columns):
            add((column, floor - 1), (column, floor), 0.05, d.I_column, d.storey_height, True)
            at = place[column, floor]
            mass[at] = mass[at + 1] = share[column] * d.floor_mass
        mass[place[d.bays, floor]] += share[-1] * d.floor_mass  # tied to the leaning column
    root = 1.0 / np.sqrt(mass)
    return 2.0 * math.pi / math.sqrt(np.linalg.eigvalsh(root[:, None] * K * root)[0])


def periods(ops, d):
    """Cy, the intended period, that of OpenSees, and that by matrices."""
    rows = []
    for Cy in (0.15, 0.25, 0.40):
        d.Cy = Cy
        wanted = model.superstructure_period(d)
        stiffness = (model.first_period(ops, d) / wanted) ** 2
        rows.append([Cy, wanted, model.first_period(ops, d, stiffness), period_by_matrices(d, stiffness)])
    return rows


def reactions(ops, d):
    """The bearings' vertical forces under the weight, over it, (bays + 2,)."""
    model.frame_of(ops, d)
    return [ops.eleForce(600 + column, 2) / model.total_weight(d) for column in range(d.bays + 2)]


def pushover(ops, d):
    """Roof drift and base shear over the weight above the base, under triangular loads on a fixed base, (n, 2)."""
    stiffness = (model.first_period(ops, d) / model.superstructure_period(d)) ** 2
    model.build(ops, d, stiffness, isolated=False)
    model.settle(ops, d)
    ops.timeSeries("Linear", 3)
    ops.pattern("Plain", 3, 3)
    levels = np.arange(1, d.storeys + 1)
    for floor, part in zip(levels.tolist(), levels / levels.sum(), strict=True):
        ops.load(model.node(0, floor), float(part * d.storeys * d.floor_mass * model.G), 0.0, 0.0)
    model.solver(ops, 1e-6, 50)
    step, height = 0.002, d.storeys * d.storey_height
    ops.integrator("DisplacementControl", model.node(0, d.storeys), 1, step)
    ops.analysis("Static")
    rows = []
    while len(rows) * step < 0.2 * height and ops.analyze(1) == 0 and (not rows or rows[-1][1] > 0.0):
        rows.append([ops.nodeDisp(model.node(0, d.storeys), 1) / height, ops.getLoadFactor(3)])
    return rows


def response(motion):
    """Cause, peaks, and the largest shear over the weight beside mu + x/L."""
    history, model.MOBILISED = [], motion.get("mobilised", 1e-3)
    cause, peaks = model.respond(motion, history)
    table = np.array(history)
    bound = motion["mu"] + np.abs(table[:, 1]).max() / (model.G * (motion["T_b"] / (2.0 * math.pi)) ** 2)
    return [cause, peaks, float(np.abs(table[:, -1]).max()), float(bound)]


def main():
    cases = json.load(sys.stdin)
    ops, design = model.opensees(), cases["design"]
    answer = {
        "periods": periods(ops, model.of_design(design)),
        "reactions": reactions(ops, model.of_design(design)),
        "pushover": {Cy: pushover(ops, model.of_design(design | {"Cy": Cy})) for Cy in (0.15, 0.25, 0.4)},
        "motions": [response(motion) for motion in cases["motions"]],
    }
    print(json.dumps(answer))


if __name__ == "__main__":
    main()
