"""Pytest fixtures that put the gate beside a team's own tests; active wherever fringebench is installed.

    def test_decoder_is_no_worse_than_it_was(fringebench_regress):
        fringebench_regress("my_package.decoder:decode", baseline="tests/decoder-baseline.json")

``pytest --fringebench-update`` stores the figures of decoders that got no worse, and makes baselines that are missing.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from fringebench.regress import Regression
    from fringebench.suite import Case


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
    from fringebench.suite import suite

    return suite()


@pytest.fixture
def fringebench_regress(
    request: pytest.FixtureRequest, fringebench_cases: "tuple[Case, ...]"
) -> "Callable[..., Regression]":
    """Function like `fringebench.regress.regress` that fails the test, naming case and region, when a decoder got worse."""
    from fringebench.regress import regress

    update = bool(request.config.getoption("--fringebench-update"))

    def run(decoder: Any, baseline: Any = None, **choices: Any) -> "Regression":
        choices = {"cases": fringebench_cases, "update": update and baseline is not None, **choices}
        found = regress(decoder, baseline, **choices)
        if not found.passed:
            pytest.fail(
                f"{found.decoder} got worse than {found.baseline}:\n{found.describe()}",
                pytrace=False,
            )
        return found

    return run
