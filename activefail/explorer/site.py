"""The site of one campaign; what takes seconds is made when it is first asked for."""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

from activefail.campaign.hazard import CAPACITY
from activefail.campaign.question import has_pulse
from activefail.errors import InputError
from activefail.explorer.answers import Answers
from activefail.explorer.pages import Answer, Question, page
from activefail.explorer.questions import one_of
from activefail.figures.curves import plot_learning_curves
from activefail.figures.svg import inline
from activefail.findings.quantities import plain, words

if TYPE_CHECKING:
    from activefail.explorer.design import DesignAnswers
    from activefail.explorer.verification import Verifications
    from activefail.findings.failure import FailureFindings
    from activefail.findings.results import Findings
    from activefail.report.evidence import Curve
    from activefail.surrogate.classifier import Classifier


_WIDTH = 4.4
"""Width of figures [in], which are read on a phone too."""


class Slow(NamedTuple):
    """What takes seconds, because it learns.

    Attributes:
        classifier: the whole one; `Answers` may have one for predictions alone.
        failure: what the campaign says of a probability; None if nothing.
        curve: the learning curve; None without one.
    """

    classifier: "Callable[[], Classifier]"
    failure: "Callable[[], FailureFindings | None]"
    curve: "Callable[[], Curve | None]"


class CampaignSite:
    """The pages of a campaign.

    Attributes:
        home: relative address of the page of all campaigns; empty if there is none.
    """

    def __init__(self, answers: Answers, slow: Slow, home: str = "") -> None:
        self._answers, self._slow, self.home = answers, slow, home

    @property
    def has_design(self) -> bool:
        """Whether the page Design works: for a pulse and a displacement capacity."""
        space = self._answers.space
        return any(one.name == CAPACITY and not one.choices for one in space.parameters) and has_pulse(space)

    @cached_property
    def _verifications(self) -> "Verifications":
        from activefail.explorer.verification import Verifications  # it loads torch

        return Verifications()

    @cached_property
    def _findings(self) -> "Findings":
        return replace(self._answers.findings, classifier=self._slow.classifier())

    @cached_property
    def _design(self) -> "DesignAnswers":
        from activefail.explorer.design import DesignAnswers

        return DesignAnswers(Answers(self._findings))

    @property
    def _links(self) -> dict[str, Any]:
        return {"home": self.home, "has_design": self.has_design}

    @cached_property
    def _explorer(self) -> str:
        return page("explorer", about=self._answers.about(), **self._links)

    def page(self, path: str) -> str | None:
        """As `Site.page`."""
        match path:
            case "/":
                return self._explorer
            case "/design" if self.has_design:
                return page("design", about=self._design.about(), **self._links)
        return None

    def question(self, path: str) -> Question | None:
        """As `Site.question`."""
        answers = self._answers
        point, variable, shown = {"point": answers.point}, answers.variable, one_of(*answers.shown)
        match path.removeprefix("/api/"):
            case "predict":
                return Question(answers.predict, point)
            case "plane":
                return Question(answers.plane, point | {"x": variable, "y": variable, "shown": shown})
            case "fragility":
                return Question(answers.fragility, point | {"along": variable})
            case "simulate":
                return Question(answers.simulate, point)
            case "histories":
                return Question(answers.histories, point | {"narrow": one_of(True, False)})
            case "failure":
                return Question(self._failure)
            case "curve":
                return Question(self._curve)
            case "progress" | "stop" as name:
                return Question(lambda id: getattr(id, name)(), {"id": self._verifications.named})
            case "design" if self.has_design:
                return Question(self._design.required, self._design.readers)
            case "verify" if self.has_design:
                return Question(self._verify, self._design.readers)
        return None

    def below(self, name: str, anew: bool) -> None:
        """As `Site.below`: none."""

    @property
    def is_busy(self) -> bool:
        """As `Site.is_busy`."""
        return "_verifications" in vars(self) and self._verifications.is_running

    def close(self) -> None:
        """Stop the verification."""
        if "_verifications" in vars(self):
            self._verifications.close()

    def _verify(self, **asked: Any) -> Answer:
        if self._design.unverified:
            raise InputError(self._design.unverified)
        return self._verifications.start(lambda verification: self._design.verified(verification, **asked))

    def _failure(self) -> Answer:
        """The section on the probability of failure, and its design point as a start; both None without them."""
        from activefail.report.failure import failure_section

        found, findings = self._slow.failure(), self._findings
        section = failure_section(findings, found, _WIDTH)
        html = section and page(
            "failure", failure=section, beyond=findings.beyond, refused=findings.campaign.settings.refused
        )
        start = None
        if found is not None and found.point is not None:
            start = {"text": f"the design point of {findings.beyond}", "point": found.point.X.tolist()}
        return {"html": html, "preset": start}

    def _curve(self) -> Answer:
        """The learning curve as a figure; None without one."""
        curve = self._slow.curve()
        if curve is None:
            return {"svg": None}
        boundary = plain(words(self._answers.findings.boundary))
        figure = plot_learning_curves(curve.scores, boundary, curve.test_size, _WIDTH)
        return {"svg": str(inline(figure, "curve", "Learning curve"))}
