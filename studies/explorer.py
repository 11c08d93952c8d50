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

from activefail.campaign.on_disk import open_campaign
from activefail.explorer.answers import Answers
from activefail.findings.results import findings_of
from activefail.loop.learning import current
from activefail.surrogate.threads import one_thread

GOALS = {"prediction": 100, "prediction while planes are drawn": 100, "simulation": 300}
"""Within which an answer is felt as at once [ms]."""


def waited(ask, designs):
    """Time of each answer [ms]."""
    taken = []
    for design in designs:
        began = time.perf_counter()
        ask(design)
        taken.append(1e3 * (time.perf_counter() - began))
    return taken


def waited_among_planes(answers, designs):
    """The same for predictions, a twentieth of a second apart, while another thread requests planes."""
    over = threading.Event()

    def planes():
        while not over.is_set():
            answers.plane(designs[0], 0, 1, answers.outcomes[-1])

    other = threading.Thread(target=planes)
    other.start()
    try:
        taken = []
        for design in designs:
            time.sleep(0.05)
            taken += waited(answers.predict, [design])
    finally:
        over.set()
        other.join()
    return taken


def main():
    options = asked(__doc__, run=Path("runs/bearing"), n=50)
    with one_thread():
        with open_campaign(options.run, write=False) as (campaign, store):
            classifier = current(campaign, store, write=False).classifier
            answers = Answers(findings_of(options.run, campaign, store, classifier))
        designs = campaign.space.latin_hypercube(options.n, np.random.default_rng(0)).tolist()
        few = designs[: max(2, options.n // 5)]
        last = len(designs[0]) - 1
        answers.plane(designs[0], 0, 1, answers.outcomes[-1])  # loads what a first drawing needs
        times = {
            "prediction": waited(answers.predict, designs),
            "prediction while planes are drawn": waited_among_planes(answers, designs),
            "plane": waited(lambda design: answers.plane(design, last - 1, last, answers.outcomes[-1]), few),
            "fragility curve": waited(lambda design: answers.fragility(design, last), few),
            "simulation": waited(answers.simulate, designs),
            "its histories as a figure": waited(lambda design: answers.histories(design, False), few),
        }
    head("answer [ms]", "median", "worst", "goal")
    for name, taken in times.items():
        line(name, f"{np.median(taken):.1f}", f"{max(taken):.1f}", GOALS.get(name, "–"))


if __name__ == "__main__":
    main()
