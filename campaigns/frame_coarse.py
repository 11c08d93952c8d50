"""The features of `frame.toml`: what a coarse model of the frame does under the record of a design.

One elastic-plastic storey on a friction pendulum with a rim, without degradation, P-Delta or uplift: two degrees of
freedom, in numba. It has the effective mass of the frame's first mode and the fixed quantities of the campaign file. A
run takes less than 0.1 ms. The feature is the record's PGV over that at which the coarse model collapses under it.
"""

import math

import numpy as np
from frame_model import MOBILISED, G, strong_part
from numba import njit

STEP, PAD = 0.01, 2.0
"""Longest step, and time after the strong part of the record [s]."""

RANGE, BISECTIONS = (0.3, 6.0), 5
"""PGV between which the capacity is sought [m/s]."""

AT_RIM = 0.5
"""Index of collapse of a bearing that just meets the rim."""

OF_DESIGN = ("T_b", "mu", "D_tot", "Cy", "PGV")

QUANTITIES = ("T_s", "damping", "storeys", "storey_height", "rim_strength", "rim_yield", "rim_limit", "drift_limit")


@njit(error_model="numpy")
def respond(a, dt, factor, T_b, mu, D_tot, Cy, fixed):
    """Displacement over D_tot, deformation of the rim over its limit, and drift over its limit; it ends at collapse.

    `a` is the ground acceleration [m/s²] at intervals `dt`, `fixed` are `QUANTITIES`. Forces are over the whole mass.
    """
    T_s, damping, storeys, height, rim_strength, rim_yield, rim_limit, drift_limit = fixed
    above = storeys / (storeys + 1.0)  # share of the mass above the isolators
    upper = above * 1.5 * (storeys + 1.0) / (2.0 * storeys + 1.0)  # of a straight first mode
    base = 1.0 - upper
    T = T_s * math.sqrt(0.25 / Cy)
    k, strength = (2.0 * math.pi / T) ** 2 * upper, Cy * above * G
    c = damping * T / math.pi * k
    pendulum, friction = (2.0 * math.pi / T_b) ** 2, mu * G
    sticking = friction / MOBILISED
    bear = rim_strength * G
    rim = bear / rim_yield
    sub = max(1, math.ceil(dt / STEP))
    h = dt / sub
    x = v = u = w = slip = frame = set_right = set_left = 0.0  # u, w: of the storey relative to the base
    largest = drift = over = 0.0
    for i in range(len(a) - 1 + int(PAD / dt)):
        begin = factor * a[i] if i < len(a) else 0.0
        end = factor * a[i + 1] if i + 1 < len(a) else 0.0
        for j in range(sub):
            ground = begin + (end - begin) * j / sub
            slip = min(friction, max(-friction, slip + sticking * v * h))
            shear = slip + pendulum * x
            if x > D_tot + set_right:
                push = rim * (x - D_tot - set_right)
                if push > bear:
                    push, set_right = bear, x - D_tot - rim_yield
                shear += push
            elif -x > D_tot + set_left:
                push = rim * (-x - D_tot - set_left)
                if push > bear:
                    push, set_left = bear, -x - D_tot - rim_yield
                shear -= push
            frame = min(strength, max(-strength, frame + k * w * h))
            pull = frame + c * w
            a_base = (pull - shear) / base - ground
            w += h * (-pull / upper - ground - a_base)
            v += h * a_base
            x += h * v
            u += h * w
            largest, drift = max(largest, abs(x)), max(drift, abs(u))
        over = max(over, largest - D_tot)
        if over > rim_limit or drift > drift_limit * height:
            break
    return largest / D_tot, max(0.0, over) / rim_limit, drift / (drift_limit * height)


@njit(error_model="numpy")
def index_of(displacement, rim, drift):
    """Of collapse: 1 where the rim breaks or the storey drifts too far, continuous below."""
    return max(AT_RIM * displacement if rim == 0.0 else AT_RIM + (1.0 - AT_RIM) * rim, drift)


@njit(error_model="numpy")
def capacity(a, dt, unit, T_b, mu, D_tot, Cy, fixed):
    """PGV at which the coarse model collapses under a record [m/s]; `unit` scales the record to a PGV of 1 m/s.

    Bisection on the logarithm between `RANGE`, and interpolation of the logarithm of the index in the last interval.
    """
    low, high = math.log(RANGE[0]), math.log(RANGE[1])
    below = above = 0.0  # logarithm of the index at both ends, 0 where it is not known
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        index = math.log(index_of(*respond(a, dt, unit * math.exp(middle), T_b, mu, D_tot, Cy, fixed)))
        if index >= 0.0:
            high, above = middle, index
        else:
            low, below = middle, index
    share = below / (below - above) if below < 0.0 < above else 0.5
    return math.exp(low + share * (high - low))


@njit(error_model="numpy", nogil=True)
def capacities(flat, start, dt, unit, which, X, fixed, out):
    """`capacity` for rows of designs, (n, 5), into (n,); records are `flat[start[k] : start[k + 1]]`."""
    for row in range(len(X)):
        k = which[row]
        a = flat[start[k] : start[k + 1]]
        out[row] = capacity(a, dt[k], unit[k], X[row, 0], X[row, 1], X[row, 2], X[row, 3], fixed)


def features(X, space):
    """Of designs, (n, d) -> (n, 6): the design, and the logarithm of its PGV over the coarse model's capacity."""
    records, which = space.objects(X, "record")
    motions = [one.motion for one in records]
    strong = [strong_part(np.asarray(motion.acceleration)) for motion in motions]
    start = np.cumsum([0, *map(len, strong)])
    dt, unit = (np.array([getattr(one, name) for one in motions]) for name in ("dt", "peak_velocity"))
    designs = space.table(X, OF_DESIGN)
    values = space.table(X, QUANTITIES)
    for name, column in zip(QUANTITIES, values.T, strict=True):
        if (column != column[0]).any():
            raise ValueError(f"the coarse model requires one value of {name}; it is no variable of these features")
    fixed = tuple(values[0].tolist())
    out = np.empty(len(X))
    capacities(np.concatenate(strong), start, dt, 1.0 / unit, np.asarray(which), designs, fixed, out)
    pgv = np.log(designs[:, 4])
    return np.column_stack([designs[:, :4], pgv, pgv - np.log(out)])
