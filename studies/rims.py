"""Bearings whose rims break or yield: outcomes by an independent program, and what the rims do to designs.

    python studies/rims.py --breaking 3000 --yielding 1000
    python studies/rims.py --bearings 8

The other program is written from docs/bearing.md alone. It integrates the plastic deformations as four more unknowns
beside positions and velocities, where activefail moves the walls between steps, and finds events by root finding:
scipy.integrate.solve_ivp with LSODA at a relative tolerance of 1e-7. It takes half a second a design. The designs are
those of Table 1 that touch a rim if it is rigid, the strengths 0.3 to 6 W and the deformations 2 to 100 mm, all drawn
at random, the latter two log-uniformly; every fourth design has the restitution "assembly". `--out FILE` keeps the rows
and continues with the others.

Also printed: the outcomes that move at a tolerance 100 times tighter, how many more steps the types take, and every
design that differs, with activefail's outcome at tighter tolerances and the other program's at 1e-9.

`--bearings N` prints a table of bearings from a Latin hypercube of Table 1: their median capacity in PGV under the
far-field records of FEMA P695, P(failure) under 1,024 pulses of magnitude 7 with a median PGV of 1 m/s, and the D_tot
from which on at most a tenth of 256 of these pulses make the bearing fail.
"""

import math
from pathlib import Path

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from study import Rows, asked, head, line, spread, timed, uniform

from activefail import ida
from activefail.seismic.bearing import TABLE_1, Model, Tolerance, simulate
from activefail.seismic.hazard.hazard import Hazard

G = 9.81
SCALE = np.array([0.1, 0.1, 0.2, 0.025, 0.025, 1.0, 1.0, 2.0, 0.25, 0.25, 0.01, 0.01, 0.01, 0.01])


@njit(error_model="numpy")
def contact(i, y, c):
    """Of vertex i: position and velocity in the frame of the facing plate, lever, place of the arc's deformation."""
    b_x, b_z = c[1] * (2 * (i % 2) - 1), c[2] * (2 * (i // 2) - 1)
    cosine, sine = math.cos(y[2]), math.sin(y[2])
    r_x, r_z = cosine * b_x - sine * b_z, sine * b_x + cosine * b_z
    x, z = y[0] + r_x, y[1] + r_z
    v_x, v_z = y[5] - y[7] * r_z, y[6] + y[7] * r_x
    if i >= 2:
        x, z, v_x, v_z = x - y[3], y[4] - z, v_x - y[8], y[9] - v_z
    return x, z, v_x, v_z, r_x, r_z, 10 + 2 * (i // 2) + (1 if x > 0.0 else 0)


@njit(error_model="numpy")
def slope(t, y, c):
    """Derivatives of the 14 unknowns: x_s, z_s, theta, x_t, z_t, their velocities, and four deformations."""
    R, _, _, k, mu, m, inertia, M, edge, top, v_r, S = c[:12]
    damping = c[12:16]  # at the bottom and the top dish, at the bottom and the top rim
    s = 2.0 * math.pi * t / (math.sqrt(3.0) * c[16])
    ground = c[17] / 1.38 * (s * s - 3.0) * s * math.exp(-0.5 * s * s)
    d = np.zeros(14)
    d[:5] = y[5:10]
    for i in range(4):
        x, z, v_x, v_z, r_x, r_z, arc = contact(i, y, c)
        up = 1.0 if i < 2 else -1.0
        f_x, f_z = 0.0, 0.0
        distance = math.sqrt(x * x + (R - z) * (R - z))
        depth = distance - R
        if depth > 0.0 and z < R:
            n_x, n_z = -x / distance, (R - z) / distance
            rate, slip = -(v_x * n_x + v_z * n_z), v_x * n_z - v_z * n_x
            N = k * depth**1.5 + damping[i // 2] * depth**0.25 * max(rate, 0.0)
            T = -mu * N * slip / math.sqrt(slip * slip + v_r * v_r)
            f_x, f_z = N * n_x + T * n_z, N * n_z - T * n_x
        outwards = 1.0 if x > 0.0 else -1.0
        depth = outwards * x - edge - y[arc]
        if depth > 0.0 and z < top:
            rate, viscous = outwards * v_x, damping[2 + i // 2] * depth**0.25
            N = k * depth**1.5 + viscous * max(rate, 0.0)
            if N > S:
                # The wall moves as fast as keeps the force at the strength.
                d[arc] += max(0.0, rate - (S - k * depth**1.5) / viscous)
                N = S
            f_x -= outwards * N
            f_z -= mu * N * v_z / math.sqrt(v_z * v_z + v_r * v_r)
        f_z *= up
        d[5] += f_x / m
        d[6] += f_z / m
        d[7] += (r_x * f_z - r_z * f_x) / inertia
        if i >= 2:
            d[8] -= f_x / M
            d[9] -= f_z / M
    d[5] -= ground
    d[8] -= ground
    d[6] -= G
    d[9] -= G
    return d


@njit(error_model="numpy")
def events(y, c):
    """Functions that become positive: touch, escape, loss of confinement, overturning, force, plastic deformation."""
    R, half, height, k, _, _, _, _, edge, top, _, S = c[:12]
    touch, escape, demand = -1.0, -1.0, 0.0
    gap = np.empty(4)
    for i in range(4):
        x, z, v_x, _, _, _, arc = contact(i, y, c)
        gap[i] = R - math.sqrt(x * x + (R - z) * (R - z))
        out = abs(x) - edge - y[arc]
        escape = max(escape, min(out, z - top))
        if z < top:
            touch = max(touch, out)
            depth = max(out, 0.0)
            rate = max(v_x if x > 0.0 else -v_x, 0.0)
            demand = max(demand, k * depth**1.5 + c[14 + i // 2] * depth**0.25 * rate)
    confinement = max(min(gap[0], gap[1]), min(gap[2], gap[3])) - c[18]
    most = max(y[10], y[11], y[12], y[13])
    return touch, escape, confinement, abs(y[2]) - math.atan2(half, height), demand - S, most - c[19]


def constants(row, model):
    """The constants of a row of Table 1, and the state at rest."""
    T_b, mu, D_tot, h_sl, h_rim, p, k, T_p, A_p = row
    R, D = G * (T_b / (2.0 * math.pi)) ** 2 / 2.0, 0.3
    area, edge = math.pi * D * D / 4.0, (D_tot + D) / 2.0
    M, m = p * 1e6 * area / G, 7850.0 * area * h_sl * D
    e = 0.65
    xi = 9.0 * math.sqrt(5.0) / 2.0 * (1.0 - e * e) / (e * (e * (9.0 * math.pi - 16.0) + 16.0))
    masses = (m, m * M / (m + M), m, m * M / (m + M)) if model.restitution == "pairwise" else (M, M, 2.0 * M, 2.0 * M)
    damping = [2.0 * xi * math.sqrt(mass * k) for mass in masses]
    top = R - math.sqrt(R * R - edge * edge) + h_rim * D
    inertia = m * (D * D / 16.0 + (h_sl * D) ** 2 / 12.0)
    bodies = [R, D / 2.0, h_sl * D / 2.0, k, mu, m, inertia, M, edge, top, 1e-3, model.rim_strength * M * G]
    c = tuple(map(float, [*bodies, *damping, T_p, A_p * G, h_rim * D, model.rim_deformation or 0.0]))

    def height(load):
        """Of two level vertices above the apex, where their forces carry a load."""

        def lack(z):
            distance = math.hypot(D / 2.0, R - z)
            return 2.0 * k * max(distance - R, 0.0) ** 1.5 * (R - z) / distance - load

        return brentq(lack, -0.2, R - math.sqrt(R * R - D * D / 4.0), xtol=1e-15)

    z_s = height((M + m) * G) + h_sl * D / 2.0
    rest = [0.0, z_s, 0.0, 0.0, z_s + h_sl * D / 2.0 + height(M * G)]
    return c, np.array([*rest, *np.zeros(9)])


def independent(row, model, relative=1e-7):
    """The outcome by the other program: 0, 1 or 2."""
    c, y = constants(row, model)
    T_b, T_p = row[0], row[7]

    def event(place):
        def function(t, y):
            return events(y, c)[place]

        function.terminal, function.direction = place > 0, 1.0
        return function

    broken = 4 if model.rim == "breaking" else 5
    path = solve_ivp(
        lambda t, y: slope(t, y, c),
        (-1.5 * T_p, 1.5 * T_p + 2.5 * T_b),
        y,
        "LSODA",
        events=[event(place) for place in (0, 1, 2, 3, broken)],
        rtol=relative,
        atol=relative * SCALE,
        max_step=min(0.01, 0.1 * T_p),
    )
    assert path.status >= 0, path.message
    return 2 if path.status == 1 else int(len(path.t_events[0]) > 0)


def ours(row, model, relative=1e-4):
    """The outcome, cause and steps by activefail."""
    run = simulate(row[None], model, Tolerance(relative), threads=1)
    return int(run.outcome[0]), str(run.cause_name[0]), int(run.statistic("steps")[0])


def models(kind, n, seed):
    """Random models with this type of rim."""
    rng = np.random.default_rng(seed)
    for k in range(n):
        strength, deformation = np.exp(rng.uniform(np.log([0.3, 2e-3]), np.log([6.0, 0.1]))).tolist()
        yields = {"rim_deformation": deformation} if kind == "yielding" else {}
        restitution = "assembly" if k % 4 == 3 else "pairwise"
        yield Model(restitution=restitution, rim=kind, rim_strength=strength, **yields)


RIMS = {
    "rigid": Model(),
    "yielding at 1.5 W, by 20 mm": Model(rim="yielding", rim_strength=1.5, rim_deformation=0.02),
    "breaking at 1.5 W": Model(rim="breaking", rim_strength=1.5),
    "yielding at 0.3 W, by 20 mm": Model(rim="yielding", rim_strength=0.3, rim_deformation=0.02),
    "breaking at 0.3 W": Model(rim="breaking", rim_strength=0.3),
    "none": Model(rim="none"),
}
TARGET, COARSE, STEP = 0.10, 0.1, 0.005
HAZARD = {"magnitude": {"M": 7.0}, "pgv": {"median_m_s": 1.0, "dispersion": 0.25}}


def required(bearing, model, pulses):
    """The D_tot [m], to `STEP`, from which on at most the target's share of the pulses makes the bearing fail."""

    def fails(capacity):
        X = np.column_stack([np.tile([*bearing[:2], capacity, *bearing[3:]], (len(pulses), 1)), pulses])
        return float((simulate(X, model, threads=1).outcome == 2).mean()) > TARGET

    # From the largest downwards, because very small capacities may be met again.
    most = min(1.5, 0.999 * (G * (bearing[0] / (2.0 * math.pi)) ** 2 - model.slider_diameter))
    high, low = most, most - COARSE
    while low > COARSE and not fails(low):
        high, low = low, low - COARSE
    while high - low > STEP:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if fails(middle) else (low, middle)
    return high


def compare_types(count, seed):
    """Print the table of the types of rim."""
    X = TABLE_1.latin_hypercube(count, np.random.default_rng(seed))[:, :7]
    found = {name: [] for name in RIMS}
    for bearing in X:
        fixed = dict(zip(TABLE_1.names, bearing.tolist(), strict=False))
        question = Hazard.of(HAZARD, Path("hazard.toml")).question(TABLE_1, fixed)
        designs = question.designs(question.space.sobol(1024, np.random.default_rng(seed)))
        for name, model in RIMS.items():
            capacity = ida(bearing, "farfield", scale_to="pgv", model=model, workers=1).fragility.fit.median
            failing = float((simulate(designs, model, threads=1).outcome == 2).mean())
            found[name].append((capacity, failing, required(bearing, model, designs[:256, 7:])))
    head("rims", "median capacity, PGV [m/s]", "over rigid", "P(failure)", "D_tot for 10 % [m]", "over rigid")
    rigid = np.array(found["rigid"])
    for name, values in found.items():
        capacity, failing, needed = np.array(values).T
        ratios = spread(capacity / rigid[:, 0]), spread(needed / rigid[:, 2])
        line(name, spread(capacity), ratios[0], spread(failing, 3), spread(needed), ratios[1])


def main():
    options = asked(__doc__, breaking=0, yielding=0, bearings=0, seed=1, out=Path)
    if options.bearings:
        compare_types(options.bearings, options.seed)
    rows = Rows(options.out, seed=options.seed)
    for kind in ("breaking", "yielding"):
        n = getattr(options, kind)
        if not n:
            continue
        X = uniform(3 * n + 50, options.seed)
        X = X[simulate(X, threads=1).outcome > 0][:n]
        cases = list(zip(X, models(kind, n, options.seed), strict=True))
        for k, (row, model) in enumerate(cases):
            if rows.lack(kind=kind, k=k):
                outcome, cause, steps = ours(row, model)
                theirs, seconds = timed(independent, row, model)
                tight, rigid = ours(row, model, 1e-6)[0], ours(row, Model(restitution=model.restitution))[2]
                found = {"ours": outcome, "theirs": theirs, "tight": tight, "cause": cause}
                rows.add(kind=kind, k=k, **found, steps=steps, rigid=rigid, seconds=seconds)
        done = [one for one in rows.of(kind=kind) if one["k"] < n]
        equal = sum(one["ours"] == one["theirs"] for one in done)
        moved = sum(one["ours"] != one["tight"] for one in done)
        broken = sum(one["cause"] == "rim_fracture" for one in done)
        steps, rigid, seconds = (np.array([one[name] for one in done]) for name in ("steps", "rigid", "seconds"))
        print(
            f"{kind}: {equal} of {n} outcomes equal; {moved} move at a tolerance 100 times tighter; {broken} "
            f"fractures; {steps.mean() / rigid.mean():.2f} times the steps of rigid rims; the other program takes "
            f"{np.median(seconds):.2f} s"
        )
        for one in done:
            row, model = cases[one["k"]]
            if one["ours"] != one["theirs"]:
                found = [ours(row, model, relative)[:2] for relative in (1e-4, 1e-6, 1e-8)]
                print(
                    f"  {one['k']}: strength {model.rim_strength:.5g} W, {model.restitution}: {found}; the other "
                    f"{one['theirs']}, at 1e-9 {independent(row, model, 1e-9)}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
