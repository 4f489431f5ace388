"""The case by formula, and decoders named from the repository, as a team names its own."""

import pytest

from fringebench.gate.cases import Case, suite
from tests.commands import ROOT


@pytest.fixture(scope="session")
def sweep() -> tuple[Case, ...]:
    return suite(("sweep",))


@pytest.fixture(autouse=True)
def from_the_repository(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT))
