"""What the workers of a Dask cluster are sent; apart from the tests, so that a worker loads little for it."""

import operator
import os
import signal
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from campaign.stub import Disc

from activefail.simulators.interface import Results
from activefail.space.space import Array


@dataclass(frozen=True)
class Noted(Disc):
    """A disc that takes a while and notes where it is simulated."""

    folder: str = ""
    seconds: float = 0.2
    releases_gil = True

    def run(self, X: Array) -> Results:
        path = Path(self.folder) / f"done-{os.getpid()}"
        with path.open("a") as file:
            file.write(".")
        time.sleep(self.seconds)
        return super().run(X)


@dataclass(frozen=True)
class Fatal(Disc):
    """A disc that ends its process for some designs, and holds the interpreter's lock."""

    releases_gil = False

    def run(self, X: Array) -> Results:
        if X[0, 0] > 2.0:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().run(X)


@dataclass(frozen=True)
class Ambush(Disc):
    """A disc that kills the first worker that it is asked about a certain design by."""

    folder: str = ""
    design: tuple[float, ...] = ()
    releases_gil = True

    def run(self, X: Array) -> Results:
        if tuple(X[0].tolist()) == self.design:
            with suppress(FileExistsError):
                (Path(self.folder) / "ambush").touch(exist_ok=False)
                os.kill(os.getpid(), signal.SIGKILL)
        return super().run(X)


class Unknown(Disc):
    """A disc that no worker can load, as if the worker had another version of activefail."""

    def __reduce__(self) -> tuple[object, ...]:
        return operator.attrgetter("no_such_thing"), (0,)


class Deadly(Disc):
    """A compiled disc that ends the worker itself."""

    releases_gil = True

    def run(self, X: Array) -> Results:
        os._exit(1)


def versions() -> dict[str, str]:
    """What differs between these tests and the workers that they start."""
    return {"activefail": "1", "leader": "there" if "DASK_TEMPORARY_DIRECTORY" in os.environ else "here"}
