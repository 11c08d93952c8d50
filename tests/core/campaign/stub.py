"""A simulator that costs nothing and whose boundary is known: a disc in the plane, two variables and two outcomes."""

import time
from dataclasses import dataclass
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np

from activefail.simulators.interface import NUMERICAL_FAILURE, Results, Simulator
from activefail.space.space import Array

if TYPE_CHECKING:
    from activefail.campaign.assembly import Campaign
    from activefail.campaign.settings import CampaignSettings

LOW, HIGH = np.array([-2.0, 10.0]), np.array([3.0, 50.0])
CENTRE, RADIUS = np.array([0.55, 0.4]), 0.32
"""Of the disc, in units of the variables' ranges; its rim comes nowhere near the bounds."""


def distance(X: Array) -> Array:
    """Signed distance of designs, (n, 2), to the boundary, in units of the ranges; positive inside the disc."""
    return np.asarray(RADIUS - np.linalg.norm((X - LOW) / (HIGH - LOW) - CENTRE, axis=1))


@dataclass(frozen=True)
class Disc:
    """Safe outside the disc, broken inside it.

    Attributes:
        blind: x below which there is no answer.
    """

    blind: float = -np.inf

    outcomes = ("safe", "broken")
    causes = ("", "crack", "fog")
    margins = ("distance",)
    releases_gil = True

    def run(self, X: Array) -> Results:
        """Answer designs (x, y), shape (n, 2)."""
        margin = distance(X)
        blind = X[:, 0] < self.blind
        outcome = np.where(blind, NUMERICAL_FAILURE, margin > 0.0)
        cause = np.where(blind, 2, margin > 0.0)
        return Results(
            outcome.astype(np.int8),
            cause.astype(np.int8),
            np.where(blind, np.nan, margin)[:, None],
            np.zeros(len(X)),
        )


class Brittle(Disc):
    """Safe in a corner and broken beyond it; no answer on the bounds, where the searches for designs like to end."""

    def run(self, X: Array) -> Results:
        """Answer designs (x, y), shape (n, 2)."""
        unit = (X - LOW) / (HIGH - LOW)
        margin = unit.sum(axis=1) - 0.25
        failed = ((unit == 0.0) | (unit == 1.0)).any(axis=1)
        outcome = np.where(failed, NUMERICAL_FAILURE, margin > 0.0).astype(np.int8)
        return Results(outcome, np.where(failed, 2, 0).astype(np.int8), margin[:, None], np.zeros(len(X)))


class Raising(Disc):
    """A disc that raises for the designs on its right."""

    def run(self, X: Array) -> Results:
        """Answer designs (x, y), shape (n, 2)."""
        if (X[:, 0] > 1.5).any():
            raise ZeroDivisionError("the stiffness vanished")
        return super().run(X)


@dataclass(frozen=True)
class Dozing(Disc):
    """A disc that takes longer for some designs."""

    def run(self, X: Array) -> Results:
        time.sleep(0.02 * (1.0 + (X[0, 0] % 1.0) * 5.0))
        return super().run(X)


class Counting:
    """A disc that counts the designs it is asked about."""

    outcomes, causes, margins, releases_gil = Disc.outcomes, Disc.causes, Disc.margins, True

    def __init__(self) -> None:
        self.rows = 0
        self._lock = Lock()

    def run(self, X: Array) -> Results:
        """Answer designs (x, y), shape (n, 2)."""
        with self._lock:
            self.rows += len(X)
        return Disc().run(X)


def given() -> "CampaignSettings":
    """Settings of a campaign whose simulator, which is safe or fails, is given as an object."""
    from activefail.campaign.settings import parse_settings

    text = 'simulator = { python = "given:run", repeatable = true }\nspace.x = { low = 0.0, high = 1.0 }\n'
    return parse_settings(text, "given")


def disc(
    simulator: Simulator | None = None,
    seed: int = 1,
    initial: int = 12,
    budget: int = 28,
    batch: int = 4,
    asynchronous: bool = False,
    extra: str = "",
) -> "Campaign":
    """A campaign on the disc; `more` is TOML that the settings get besides."""
    # Here, not above: a worker process that is sent a disc starts without the learning and its libraries.
    from activefail.campaign.assembly import Campaign
    from activefail.campaign.settings import parse_settings

    without_batches = str(asynchronous).lower()
    text = f"""
        seed = {seed}
        sampling = {{ initial = {initial}, budget = {budget}, batch = {batch}, asynchronous = {without_batches} }}
        {extra}
        simulator = {{ python = "disc:run", outcomes = ["safe", "broken"], repeatable = true }}
        classifier.features = "design"
        acquisition.boundary = "broken"
        space.x = {{ low = {LOW[0]}, high = {HIGH[0]} }}
        space.y = {{ low = {LOW[1]}, high = {HIGH[1]} }}
        """
    return Campaign.of(parse_settings(text, "disc"), simulator=simulator or Disc())
