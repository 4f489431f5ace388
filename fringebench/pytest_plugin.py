"""Pytest fixtures that put the gate into a team's own tests; active wherever fringebench is installed.

    def test_decoder_is_no_worse_than_it_was(fringebench_regress):
        fringebench_regress("my_package.decoder:decode", baseline="tests/decoder-baseline.json")

``pytest --fringebench-update`` stores the figures of decoders that got no worse, and makes baselines that are missing.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from fringebench.gate.cases import Case
    from fringebench.gate.regression_result import Regression


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add ``--fringebench-update``."""
    parser.getgroup("fringebench").addoption(
        "--fringebench-update",
        action="store_true",
        help="store the figures of decoders that got no worse as their baselines",
    )


@pytest.fixture(scope="session")
def fringebench_cases() -> "tuple[Case, ...]":
    """The suite's cases, prepared once a session."""
    from fringebench.gate.cases import suite

    return suite()


@pytest.fixture
def fringebench_regress(request: pytest.FixtureRequest) -> "Callable[..., Regression]":
    """The function `fringebench.gate.regression_gate.regress`; it fails the test, naming case and region, if a decoder got worse.

    The shipped cases are made once a session; with ``scenes=[...]`` the test's own scenes are judged.
    """
    from fringebench.gate.regression_gate import regress

    update = bool(request.config.getoption("--fringebench-update"))

    def run(decoder: Any, baseline: Any = None, **choices: Any) -> "Regression":
        if not choices.get("scenes"):
            choices = {"cases": request.getfixturevalue("fringebench_cases"), **choices}
        choices = {"update": update and baseline is not None, **choices}
        found = regress(decoder, baseline, **choices)
        if not found.passed:
            pytest.fail(
                f"{found.decoder} got worse than {found.baseline}:\n{found.describe()}",
                pytrace=False,
            )
        return found

    return run
