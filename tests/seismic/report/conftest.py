"""Pages of the report for claims about words."""

from collections.abc import Iterator

import pytest
from report.pictures import slow_pictures_empty


@pytest.fixture
def without_pictures(without_pictures: None) -> Iterator[None]:
    """Write pages without pictures, for a claim about words. The figures that take long are not computed either."""
    with slow_pictures_empty():
        yield
