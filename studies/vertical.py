"""What vertical motion does to the slider's confinement, and what each rule for its loss would say.

    python studies/vertical.py --n 400

Random bearings of Table 1 are under a synthetic record (a pulse and filtered noise) of 0.1 to 0.4 g, with vertical
noise of 0.3 to 2 g up to some frequency. The last rows compare the rule with itself at other tolerances, and with
loss of confinement at once where the vertical motion is nearly none and the horizontal one twice as strong.
"""

import numpy as np
from study import asked

from activefail.seismic.bearing import TABLE_1, Accelerogram, Model, Tolerance, simulate_records
from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.bearing.outcome import CAUSES, FAILURE
from activefail.seismic.bearing.pulse import ground_acceleration

DT, SECONDS = 0.01, 15.0


def noise(rng, corner):
    """Noise between 0.3 Hz and a corner frequency [Hz] in an envelope, with a peak of 1."""
    n = int(SECONDS / DT)
    f = np.fft.rfftfreq(n, DT)
    shape = (f / 0.3) ** 2 / (1.0 + (f / 0.3) ** 2) / (1.0 + (f / corner) ** 2)
    a = np.fft.irfft(np.fft.rfft(rng.standard_normal(n)) * shape, n)
    a *= np.exp(-0.5 * ((np.arange(n) * DT - 5.5) / 2.5) ** 2)
    return a / np.abs(a).max()


def ground(rng, corner):
    """A synthetic record with its vertical component."""
    pulse = np.array([ground_acceleration(t - 5.0, 1.0, 2.0) for t in np.arange(int(SECONDS / DT)) * DT])
    a = pulse / np.abs(pulse).max() + 0.5 * noise(rng, 3.0)
    a *= rng.uniform(0.1, 0.4) * GRAVITY / np.abs(a).max()
    return Accelerogram(a, DT, vertical=rng.uniform(0.3, 2.0) * GRAVITY * noise(rng, corner))


def main():
    options = asked(__doc__, n=400, seed=1)
    for corner in (3.0, 8.0, 15.0):
        rng = np.random.default_rng([options.seed, int(corner)])
        X = TABLE_1.latin_hypercube(options.n, rng)[:, :7]
        records = [ground(rng, corner) for _ in range(options.n)]
        found = simulate_records(X, records)
        untouched = np.isnan(found.margin("first_touch_time"))
        lifted = untouched & (found.margin("peak_gap_ratio") > 1.0)
        failed = found.outcome == FAILURE
        causes = {name: int((lifted & failed & (found.cause == CAUSES.index(name))).sum()) for name in CAUSES[1:4]}
        print(f"vertical noise up to {corner:g} Hz: of {options.n} bearings {failed.sum()} fail")
        print(f"  {lifted.sum()} lift by more than h_rim and touch no rim")
        print(f"  {(lifted & failed).sum()} of these fail: {causes}")
        never = simulate_records(X, records, Model(loss_of_confinement=False))
        print(f"  {(never.outcome != found.outcome).sum()} outcomes differ if loss of confinement is no failure")
        finer = simulate_records(X, records, tolerance=Tolerance(relative=1e-6))
        print(f"  {(finer.outcome != found.outcome).sum()} outcomes differ at a tolerance of 1e-6")
        flat = [Accelerogram(2.0 * one.acceleration, DT) for one in records]
        nearly = [
            one.with_vertical(Accelerogram(1e-4 * was.vertical, DT)) for one, was in zip(flat, records, strict=True)
        ]
        one, other = simulate_records(X, flat), simulate_records(X, nearly)
        print(
            f"  {(one.outcome != other.outcome).sum()} outcomes differ between none and 1e-4 of the vertical motion, "
            f"where {(one.outcome == FAILURE).sum()} fail"
        )


if __name__ == "__main__":
    main()
