"""Tests that need openseespy get the interpreter that has it."""

import pytest
from tools import OPENSEES


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if "opensees" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.needs("openseespy"))


@pytest.fixture
def opensees() -> str:
    """An interpreter that has openseespy."""
    return OPENSEES
