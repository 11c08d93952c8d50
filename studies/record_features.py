"""What predicts failure under a record from which nothing was learned: one event left out at a time.

    python studies/record_features.py

Needs `activefail[records]`. Bearings and scaled far-field records are drawn as `campaigns/records.toml` says. For each
event, a classifier learns from simulations under the records of the other events, and predicts those of this event.
Equivalent pulses and the reduced model (m* > 0) predict without learning. "right" is the share of right predictions
with its interval over events (jackknife). "missed" is the share of the failures that were not predicted, "false" the
share of the designs without failure for which one was predicted.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from study import asked, head, line, timed

from activefail.analyses.fragility.capacities import jackknife
from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import read_settings
from activefail.learning.features import CustomFeatures, feature_map
from activefail.learning.model.latent import VariationalGP
from activefail.learning.model.training import train
from activefail.seismic.bearing import TABLE_1, simulate_records
from activefail.seismic.bearing import outcome as o
from activefail.seismic.ida.equivalent_pulse import equivalent_pulse
from activefail.seismic.motions.intensity import spectral_acceleration

CAMPAIGNS = Path(__file__).parents[1] / "campaigns"
BEARING = TABLE_1.names[:7]
PERIODS = np.linspace(2.0, 6.0, 17)


def measures_of(motions):
    """Of each record: ln of PGA over PGV, the equivalent pulse's T_p and amplitude, explained share; S_d at PERIODS."""
    pulses = [equivalent_pulse(motion) for motion in motions]
    numbers = np.log(
        [
            [motion.peak / motion.peak_velocity, pulse.period, abs(pulse.amplitude), pulse.explained]
            for motion, pulse in zip(motions, pulses, strict=True)
        ]
    )
    spectra = np.array(
        [[spectral_acceleration(motion, T) * (T / (2.0 * np.pi)) ** 2 for T in PERIODS] for motion in motions]
    )
    return pulses, numbers, spectra


def feature_sets(space):
    """Features by name: functions of designs and their space, or the names of shipped ones."""
    column, record = space.names.index("record"), space.parameters[space.names.index("record")]
    _, numbers, spectra = measures_of([one.motion for one in record.payload()])
    of_design, physics = feature_map("design", space), feature_map("collision", space).raw
    unscaled = replace(record.payload, level="", measure="factor")

    def without_record(X, space):
        return np.column_stack([space.table(X, BEARING), np.log(space.table(X, ("PGV",)))])

    def as_recorded(X, space):
        return np.column_stack([without_record(X, space), np.log(unscaled.features(X[:, column].astype(int), {}))])

    def intensities(X, space):
        which = X[:, column].astype(int)
        factor = record.payload.factors(which, {"PGV": space.table(X, ("PGV",))[:, 0]})
        T_b, D_tot = space.table(X, ("T_b", "D_tot")).T
        S_d = factor * np.array([np.interp(T, PERIODS, spectra[k]) for T, k in zip(T_b, which, strict=True)])
        scaled = numbers[which] + np.log(factor)[:, None] * np.array([0.0, 0.0, 1.0, 0.0])
        return np.column_stack([without_record(X, space), scaled, np.log(S_d / D_tot)])

    def cheap_models(X, space):
        return np.column_stack([np.log(of_design.raw(X)[:, 7:-1]), without_record(X, space), physics(X)[:, -3:]])

    def everything(X, space):
        return np.column_stack([intensities(X, space), physics(X)[:, -3:]])

    return {
        "bearing and PGV": without_record,
        "with the record as 0 and 1": lambda X, space: np.column_stack(
            [without_record(X, space), record.indicators(X[:, column])]
        ),
        "with PGA, PGV and Sa as recorded": as_recorded,
        "with PGA and Sa of the scaled record (default)": "design",
        "with intensities for the bearing": intensities,
        "with v*, a*, m* (records.toml)": "collision",
        "with v*, a*, m*, PGA and Sa of the scaled record": cheap_models,
        "with v*, a*, m* and intensities for the bearing": everything,
    }


def main():
    options = asked(__doc__, designs=4000, learn=[250, 500, 2000], seed=1)
    torch.set_num_threads(1)
    space = Campaign.of(read_settings(CAMPAIGNS / "records.toml"), CAMPAIGNS).space
    record = space.parameters[space.names.index("record")]
    motions = [one.motion for one in record.payload()]
    events, velocities = record.groups, np.array([motion.peak_velocity for motion in motions])
    rng = np.random.default_rng(options.seed)
    X = rng.permutation(space.latin_hypercube(options.designs, rng))
    bearings, velocity = space.table(X, BEARING), space.table(X, ("PGV",))[:, 0]
    _, which = space.objects(X, "record")

    def outcomes(ground):
        scaled = [ground[k].scaled(v / velocities[k]) for k, v in zip(which, velocity, strict=True)]
        run = simulate_records(bearings, scaled)
        return np.where(run.cause == o.NO_TOUCH, o.FAILURE, run.outcome).astype(np.int8)

    collision = feature_map("collision", space).raw
    outcome, simulated = timed(outcomes, motions)
    physics, computed = timed(lambda: collision(X)[:, -3:])
    event = np.array(events)[which]
    fails = outcome == o.FAILURE
    print(
        f"{len(X)} simulations under {len(motions)} records of {len(set(events))} events; {fails.mean():.1%} failures"
    )
    milliseconds = [1e3 * seconds / len(X) for seconds in (simulated, computed)]
    print("processor time of a design: simulation {:.1f} ms, v*, a* and m* {:.2f} ms".format(*milliseconds))
    head("predicted by", "learned from", "right", "missed", "false")

    def show(name, count, predicted):
        right = predicted == fails
        half = jackknife(lambda kept: float(right[kept].mean()), event)
        bounds = f"({right.mean() - half:.1%} to {min(right.mean() + half, 1.0):.1%})"
        missed, false = (fails & ~predicted).sum() / fails.sum(), (~fails & predicted).sum() / (~fails).sum()
        line(name, count, f"{right.mean():.1%} {bounds}", f"{missed:.1%}", f"{false:.1%}")

    show("no failure, ever", "-", np.zeros(len(X), dtype=bool))
    pulses, _, _ = measures_of(motions)
    show("equivalent pulse, simulated", "-", outcomes([pulse.motion for pulse in pulses]) == o.FAILURE)
    show("reduced model, m* > 0", "-", physics[:, -1] > 0.0)
    for name, features in feature_sets(space).items():
        custom = features if isinstance(features, str) else CustomFeatures("features", features, variables=False)
        mapped = feature_map(custom, space)
        for count in options.learn:
            predicted = np.zeros(len(X), dtype=bool)
            for one in dict.fromkeys(events):
                rows = np.flatnonzero(event != one)[:count]
                classifier = train(X[rows], outcome[rows], o.OUTCOMES, mapped, VariationalGP("matern52"))
                here = event == one
                predicted[here] = classifier.probabilities(X[here]).argmax(axis=1) == o.FAILURE
            show(name, count, predicted)


if __name__ == "__main__":
    main()
