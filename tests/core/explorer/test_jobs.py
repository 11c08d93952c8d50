"""Jobs of the explorer."""

from patience import until

from activefail.errors import SimulationError
from activefail.pages.explorer.jobs import Job, Jobs


def test_a_verification_tells_why_it_has_no_result(capfd):
    faults = []
    with Jobs() as jobs:
        for error in (SimulationError("None gave an outcome."), RuntimeError("a secret")):

            def broken(job: Job, error: Exception = error) -> None:
                raise error

            jobs.start(broken, None)
            until(lambda: jobs.last.state == "failed", "its end")
            faults.append(jobs.last.fault)
    assert faults == ["None gave an outcome.", "The explorer failed; its terminal shows the error."]
    assert "a secret" in capfd.readouterr().err
