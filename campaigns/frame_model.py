"""An isolated steel frame in OpenSees, from gravity to collapse under one record: the program of `frame.toml`.

    python frame_model.py design.json answer.json        # as a campaign runs it
    python frame_model.py design.json                    # prints the answer

`design.json` has the variables and the fixed quantities of `frame.toml` by name, `record`, a file with an acceleration
[m/s²] in each line, and `record_dt` [s]. The program needs openseespy and NumPy but nothing from activefail, so it runs
in an environment of its own. Where openseespy is in activefail's environment, `python = "frame_model:run"` works too.
`frame.tcl` is the same frame for the program OpenSees. docs/frame.md describes the study.

The frame, in two dimensions, SI units:

- Storeys and bays as the campaign file says. Beams and columns are elastic with a hinge at each end (IMKBilin, which
  softens and degrades), in zero-length elements. Hinge and member in series have the stiffness of the member.
- The gravity frames around it are a leaning column of hinged trusses. It carries the weight that the frame does not,
  and the P-Delta effect of it.
- A friction pendulum (singleFPBearing) under every column, which lifts off. The leaning column has one too.
- One rim for all bearings: after D_tot a yielding spring, which breaks at a deformation.

Where to begin with a frame of your own: replace `build`, and keep `settle`, `shake` and the rules of collapse.
"""

import json
import math
import os
import sys
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np

G = 9.81
HINGE = 10.0
"""Stiffness of a hinge over that of its member, 6 E I / L. Ibarra and Krawinkler's way to keep a hinge elastic until it
yields; large enough that the hinge adds little, small enough that the solver converges."""

GROUND, RIM = 5, 9001
"""Node below a bearing, counted from the node of its column; the fixed node of the rim."""

MOBILISED = 1e-3
"""Displacement that mobilises friction [m]."""

STRONG_PART = (1e-4, 0.997)
"""Shares of the Arias intensity between which a record is simulated: weak ends cost time and change nothing."""

PAD = 4.0
"""Time after the strong part [s]."""

TOLERANCE, ITERATIONS = 1e-5, 10
"""Of a displacement increment [m]. With 1e-6 and no looser fall-back the solver crawls through collapse."""

MOST_TROUBLE, DEEPEST = 800, 4
"""Steps of a run that did not converge at once, and how often one is quartered, before the run is given up."""

DIVERGED = 0.6
"""A run that stops converging beyond this share of the drift limit has collapsed; below it, it has no result."""


def opensees():
    """OpenSees as a Python module; imported here, so that the rest of this file needs none.

    Raises:
        RuntimeError: if it cannot be imported.
    """
    try:
        import openseespy.opensees as ops
    except (ImportError, RuntimeError) as error:  # a RuntimeError if a library that it needs is missing
        raise RuntimeError(
            f"{sys.executable} cannot import openseespy ({error}). Install it there with `pip install openseespy`. On "
            "Debian it also needs the packages libblas3, liblapack3 and libgfortran5"
        ) from None
    return ops


def node(column, floor):
    """Tag of the node of a column at a floor; the leaning column is the last. Its digits + 1 to 5 are beside it."""
    return 100 * floor + 10 * column


def weights(d):
    """Share of a floor's weight on each column, (bays + 2,): the frame's, half at the ends, and the leaning one's."""
    inner = np.array([0.5, *[1.0] * (d.bays - 1), 0.5]) / d.bays
    return [*(d.frame_share * inner), 1.0 - d.frame_share]


def total_weight(d):
    """Of all floors and the base [N]."""
    return (d.storeys + 1) * d.floor_mass * G


def superstructure_period(d):
    """On a fixed base [s]: the stiffness goes with the strength, T_s is the period at Cy = 0.25."""
    return d.T_s * math.sqrt(0.25 / d.Cy)


def plastic_moments(d):
    """Of beams and columns [N m].

    All beams and the columns' bases yield under a triangular load whose base shear is Cy times the weight of
    the floors above the base; columns are stronger than beams by `column_ratio`.
    """
    levels = np.arange(1, d.storeys + 1)
    overturning = d.Cy * d.storeys * d.floor_mass * G * d.storey_height * (levels**2).sum() / levels.sum()
    beam = overturning / (2 * d.bays * d.storeys + (d.bays + 1) * d.column_ratio)
    return beam, d.column_ratio * beam


def build(ops, d, stiffness=1.0, isolated=True):
    """Build the frame; `stiffness` multiplies that of all members and hinges.

    Returns the tags of the elastic members, the only ones that are damped.
    """
    leaning = d.bays + 1
    share, W = weights(d), total_weight(d)
    E = d.E * stiffness
    ops.wipe()
    ops.model("basic", "-ndm", 2, "-ndf", 3)
    for floor in range(d.storeys + 1):
        for column in range(leaning + 1):
            ops.node(node(column, floor), column * d.bay, floor * d.storey_height)
            mass = share[column] * d.floor_mass
            ops.mass(node(column, floor), mass, mass, 1.0)
        # The beams' axial stiffness is the diaphragm. A chain of equalDOF (hinge, grid node, master) gives wrong
        # results under Transformation without a word.
        ops.equalDOF(node(d.bays, floor), node(leaning, floor), 1)
        ops.fix(node(leaning, floor), 0, 0, 1)

    hinges = 0
    members = []

    def hinge(at, end, moment, member, capping, softening, energy):
        nonlocal hinges
        hinges += 1
        # Of IMKBilin: residual strength 0.3, strength 1.1 at capping, rotation of 0.5 at the end. Bilin and
        # ModIMKPeakOriented did not converge here.
        side = (capping, softening, 0.5, moment, 1.1, 0.3)
        degrading = (energy, energy, energy, 1.0, 1.0, 1.0, 1.0, 1.0)
        ops.uniaxialMaterial("IMKBilin", 1000 + hinges, HINGE * member, *side, *side, *degrading)
        ops.equalDOF(at, end, 1, 2)
        ops.element("zeroLength", 50000 + hinges, at, end, "-mat", 1000 + hinges, "-dir", 6)

    def member(tag, first, last, i, j, moment, area, inertia, length, transformation, of_hinge):
        ops.node(i, *ops.nodeCoord(first))
        ops.node(j, *ops.nodeCoord(last))
        own = 6.0 * E * inertia / length
        hinge(first, i, moment, own, *of_hinge)
        hinge(last, j, moment, own, *of_hinge)
        stiffer = (1.0 + 1.0 / HINGE) * inertia * stiffness
        ops.element("elasticBeamColumn", tag, i, j, area, d.E, stiffer, transformation)
        members.append(tag)

    ops.geomTransf("Linear", 1)
    ops.geomTransf("PDelta", 2)
    of_beam, of_column = plastic_moments(d)
    in_beam = (d.beam_capping, d.beam_softening, d.beam_energy)
    in_column = (d.column_capping, d.column_softening, d.column_energy)
    for floor in range(1, d.storeys + 1):
        for bay in range(d.bays):
            first, last = node(bay, floor), node(bay + 1, floor)
            member(len(members) + 1, first, last, first + 1, last + 2, of_beam, 0.3, d.I_beam, d.bay, 1, in_beam)
    for storey in range(d.storeys):
        for column in range(leaning):
            first, last = node(column, storey), node(column, storey + 1)
            ends = (first, last, first + 3, last + 4)
            member(len(members) + 1, *ends, of_column, 0.05, d.I_column, d.storey_height, 2, in_column)
        ops.uniaxialMaterial("Elastic", 900 + storey, d.E)
        ops.element("corotTruss", 800 + storey, node(leaning, storey), node(leaning, storey + 1), 0.5, 900 + storey)
    for bay in range(d.bays):  # the base is stiff and strong
        ops.element("elasticBeamColumn", 700 + bay, node(bay, 0), node(bay + 1, 0), 0.3, d.E, 5e-3, 1)
        members.append(700 + bay)

    if not isolated:
        for column in range(leaning + 1):
            ops.fix(node(column, 0), 1, 1, int(column < leaning))
        return members
    length = G * (d.T_b / (2.0 * math.pi)) ** 2
    ops.frictionModel("Coulomb", 1, d.mu)
    ops.uniaxialMaterial("Elastic", 2, 1.0)  # against rotation
    for column in range(leaning + 1):
        load = share[column] * W
        top = node(column, 0)
        ops.node(top + GROUND, column * d.bay, 0.0)
        ops.fix(top + GROUND, 1, 1, 1)
        # Shortens by 1 mm under the weight and lifts off. ENT has the tangent of tension at 0, so gravity diverges.
        lift = ("-strain", -1.0, 1e-5, 1.0, "-stress", -load / 1e-3, 0.01 * load, 0.1 * load)
        ops.uniaxialMaterial("ElasticMultiLinear", 20 + column, 0.0, *lift)
        initial = load * (d.mu / MOBILISED + 1.0 / length)
        up = ("-orient", 0.0, 1.0, 0.0, -1.0, 0.0, 0.0)
        local = ("-P", 20 + column, "-Mz", 2, *up, "-iter", 100, 1e-6 * load)  # the tolerance is a force
        ops.element("singleFPBearing", 600 + column, top + GROUND, top, 1, length, initial, *local)
    return members


def settle(ops, d):
    """Apply the weight.

    Raises:
        RuntimeError: if there is no equilibrium.
    """
    ops.timeSeries("Constant", 1)
    ops.pattern("Plain", 1, 1)
    for floor in range(d.storeys + 1):
        for column, share in enumerate(weights(d)):
            ops.load(node(column, floor), 0.0, -share * d.floor_mass * G, 0.0)
    solver(ops, 1e-8, 50)
    ops.integrator("LoadControl", 0.1)
    ops.analysis("Static")
    if ops.analyze(10) != 0:
        raise RuntimeError("no equilibrium under the weight")
    ops.loadConst("-time", 0.0)
    ops.wipeAnalysis()


def solver(ops, tolerance, iterations):
    """Newton's method."""
    ops.constraints("Transformation")
    ops.numberer("RCM")
    ops.system("BandGeneral")
    ops.test("NormDispIncr", tolerance, iterations)
    ops.algorithm("Newton")


def add_rim(ops, d):
    """A spring that is met at D_tot on either side and yields at `rim_strength` times the weight."""
    force = d.rim_strength * total_weight(d)
    ops.node(RIM, 0.0, 0.0)
    ops.fix(RIM, 1, 1, 1)
    for tag, sign in ((41, 1.0), (42, -1.0)):
        stiffness = force / d.rim_yield
        ops.uniaxialMaterial("ElasticPPGap", tag, stiffness, sign * force, sign * d.D_tot, 0.02, "damage")
    ops.element("zeroLength", 650, RIM, node(0, 0), "-mat", 41, 42, "-dir", 1, 1)


def first_period(ops, d, stiffness=1.0):
    """Of the frame on a fixed base [s], by OpenSees."""
    build(ops, d, stiffness, isolated=False)
    return 2.0 * math.pi / math.sqrt(ops.eigen("-genBandArpack", 2)[0])


class Stepper:
    """Advances the analysis by a step.

    If Newton's method fails: Krylov-Newton at the same tolerance, a line search, and then four quarter steps, at ten
    times the tolerance. An algorithm that stays looser than necessary would change the response of other steps.
    """

    def __init__(self, ops):
        self.ops, self.troubled = ops, 0

    def __call__(self, dt, depth=0):
        """Returns whether it converged."""
        ops = self.ops
        if ops.analyze(1, dt) == 0:
            return True
        self.troubled += 1
        if self.troubled > MOST_TROUBLE:
            return False
        ops.test("NormDispIncr", TOLERANCE * (10.0 if depth else 1.0), 25)
        ops.algorithm("KrylovNewton")
        failed = ops.analyze(1, dt)
        if failed and depth >= 2:
            ops.algorithm("NewtonLineSearch", 0.8)
            failed = ops.analyze(1, dt)
        ops.test("NormDispIncr", TOLERANCE, ITERATIONS)
        ops.algorithm("Newton")
        return not failed or (depth < DEEPEST and all(self(dt / 4.0, depth + 1) for _ in range(4)))


def strong_part(acceleration):
    """A record without its weak ends."""
    energy = np.cumsum(np.square(acceleration))
    first, last = np.searchsorted(energy / energy[-1], STRONG_PART)
    return acceleration[max(first - 1, 0) : last + 1]


def shake(ops, d, acceleration, dt, step, history=None):
    """Simulate a record until the frame collapses or the motion is over.

    Args:
        acceleration: of the ground [m/s²].
        dt: its interval [s].
        step: of the integration [s].
        history: a list for a row at each step: time, displacements of base and floors [m], shear of the isolators
            over the weight.

    Returns a cause, empty without a collapse, and the peaks.

    Raises:
        RuntimeError: if the analysis stops far from collapse.
    """
    leaning = d.bays + 1
    ops.timeSeries("Path", 2, "-dt", dt, "-values", *acceleration.tolist())
    ops.pattern("UniformExcitation", 2, 1, "-accel", 2)
    solver(ops, TOLERANCE, ITERATIONS)
    ops.integrator("HHT", 0.9)
    ops.analysis("Transient")
    end = len(acceleration) * dt + PAD
    floors = [node(0, floor) for floor in range(d.storeys + 1)]
    bases = [node(column, 0) for column in range(leaning)]
    at_rest = [ops.nodeDisp(base, 2) for base in bases]
    advance, drift, peak, uplift, touch, cause = Stepper(ops), 0.0, 0.0, 0.0, 0.0, ""
    while ops.getTime() < end - 1e-9 and not cause:
        if not advance(step):
            if drift < DIVERGED * d.drift_limit:
                raise RuntimeError(f"no convergence at {ops.getTime():.3f} s, with a drift of {drift:.4f}")
            cause = "divergence"
            break
        u = [ops.nodeDisp(floor, 1) for floor in floors]
        x = abs(u[0])
        if x >= d.D_tot and not touch:
            touch = abs(ops.nodeVel(floors[0], 1))
        peak = max(peak, x)
        drift = max(drift, *(abs(above - below) / d.storey_height for below, above in pairwise(u)))
        lift = max(ops.nodeDisp(base, 2) - rest for base, rest in zip(bases, at_rest, strict=True))
        uplift = max(uplift, lift)
        if history is not None:
            shear = sum(ops.eleForce(600 + column, 1) for column in range(leaning + 1)) / total_weight(d)
            history.append((ops.getTime(), *u, shear))
        if x > d.D_tot + d.rim_limit:
            cause = "rim"
        elif lift > d.rim_height and x > d.D_tot:
            cause = "uplift"
        elif drift > d.drift_limit:
            cause = "drift"
    peaks = {
        "peak_drift": drift,
        "displacement_ratio": peak / d.D_tot,
        "uplift": uplift,
        "touch_velocity": touch,
        "troubled_steps": float(advance.troubled),
    }
    return cause, peaks


def of_design(design):
    """The design with its quantities as attributes, numbers that count as integers.

    Raises:
        ValueError: if the frame cannot be built.
    """
    d = SimpleNamespace(**design)
    for name in ("storeys", "bays"):
        count = getattr(d, name)
        if count != int(count) or not 1 <= count <= 8:  # the tags of nodes have one digit for each
            raise ValueError(f"{name} must be a whole number from 1 to 8, got {count}")
        setattr(d, name, int(count))
    return d


def motion_of(record, dt=None):
    """Acceleration [m/s²] and interval [s] of a file, or of the record that a Python function gets."""
    if isinstance(record, str):
        return np.loadtxt(record), float(dt)
    return np.asarray(record.motion.acceleration), record.motion.dt


def frame_of(ops, d):
    """Build the isolated frame of a design under its weight, with rim and damping."""
    period = superstructure_period(d)
    members = build(ops, d, (first_period(ops, d) / period) ** 2)
    settle(ops, d)
    add_rim(ops, d)
    # In proportion to the initial stiffness of the elastic members alone. Damping of hinges would bear load that they
    # cannot bear after yielding, and mass or isolators in it would damp the isolated motion.
    ops.region(1, "-ele", *members, "-rayleigh", 0.0, 0.0, d.damping * period / math.pi, 0.0)


def respond(design, history=None, collapses=True):
    """The cause of collapse and the peaks of a design; `collapses = False` only records, for checks."""
    ops, d = opensees(), of_design(design)
    acceleration, dt = motion_of(d.record, getattr(d, "record_dt", None))
    if not collapses:
        d.rim_limit = d.rim_height = d.drift_limit = math.inf
    frame_of(ops, d)
    return shake(ops, d, strong_part(acceleration), dt, d.time_step, history)


def run(design):
    """The answer of a design as a campaign reads it."""
    cause, peaks = respond(design)
    return {"outcome": "collapse" if cause else "safe", "cause": cause, "margins": peaks}


def main(words):
    """Read a design, simulate it, write the answer."""
    if len(words) not in (1, 2):
        sys.exit("usage: python frame_model.py design.json [answer.json]")
    try:
        answer = json.dumps(run(json.loads(Path(words[0]).read_text(encoding="utf-8"))))
    except (OSError, ValueError, RuntimeError, AttributeError) as error:
        print(f"frame_model.py: {error}.", file=sys.stderr, flush=True)
        os._exit(1)  # OpenSees would write a last line of its own
    if len(words) == 2:
        Path(words[1]).write_text(answer + "\n", encoding="utf-8")
    else:
        print(answer)


if __name__ == "__main__":
    main(sys.argv[1:])
