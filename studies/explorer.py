"""Response times of the explorer: a prediction, a plane, a fragility curve, a simulation.

    python studies/explorer.py --run runs/bearing --n 50

Designs are drawn from the campaign's space. Each request is sent n times (a plane and a curve a fifth of that) with
no other request in progress. Predictions are also timed while planes are requested without a pause, as by a moving
slider. Times are those of the answer [ms], without HTTP and the browser, which take a few more.
"""

import threading
import time
from pathlib import Path

import numpy as np
from study import asked, head, line

from activefail.analyses.findings.results import findings_of
from activefail.campaign.on_disk import open_campaign
from activefail.learning.model.threads import one_thread
from activefail.loop.learning import current
from activefail.pages.explorer.campaign import OneDesign, Slow

GOALS = {"prediction": 100, "prediction while planes are drawn": 100, "simulation, with its histories as a figure": 300}
"""Within which an answer is felt as at once [ms]."""


def waited(ask, designs):
    """Time of each answer [ms]."""
    taken = []
    for design in designs:
        began = time.perf_counter()
        ask(design)
        taken.append(1e3 * (time.perf_counter() - began))
    return taken


def waited_among_planes(one, designs):
    """The same for predictions, a twentieth of a second apart, while another thread requests planes."""
    over = threading.Event()

    def planes():
        while not over.is_set():
            one.plane(designs[0])

    other = threading.Thread(target=planes)
    other.start()
    try:
        taken = []
        for design in designs:
            time.sleep(0.05)
            taken += waited(one.predict, [design])
    finally:
        over.set()
        other.join()
    return taken


def main():
    options = asked(__doc__, run=Path("runs/bearing"), n=50)
    with one_thread():
        with open_campaign(options.run, write=False) as (campaign, store):
            classifier = current(campaign, store, write=False).classifier
            slow = Slow(lambda: classifier, lambda: None, lambda: None)
            one = OneDesign(findings_of(options.run, campaign, store, classifier), slow)
        *_, across, up = names = campaign.space.names
        shown = {"across": across, "up": up, "shown": one.outcomes[-1], "along": up}
        drawn = campaign.space.latin_hypercube(options.n, np.random.default_rng(0)).tolist()
        designs = [dict(zip(names, X, strict=True)) | shown for X in drawn]
        few = designs[: max(2, options.n // 5)]
        one.plane(designs[0])  # loads what a first drawing needs
        times = {
            "prediction": waited(one.predict, designs),
            "prediction while planes are drawn": waited_among_planes(one, designs),
            "plane": waited(one.plane, few),
            "fragility curve": waited(one.fragility, few),
            "simulation, with its histories as a figure": waited(one.simulate, few),
        }
    head("answer [ms]", "median", "worst", "goal")
    for name, taken in times.items():
        line(name, f"{np.median(taken):.1f}", f"{max(taken):.1f}", GOALS.get(name, "–"))


if __name__ == "__main__":
    main()
