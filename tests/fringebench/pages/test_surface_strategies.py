"""The table of strategy by surface: coverage comes before error, and overlapping intervals are a tie."""

import json
from collections.abc import Callable
from typing import Any

from fringebench.pages.surface_strategies import best_strategies, strategy_table


def entry(name: str, median_um: float | None, coverage: float, half_width_um: float = 0.1) -> Any:
    half_width = {"median_abs_mm": half_width_um * 1e-3}
    median = None if median_um is None else median_um * 1e-3
    region = {"pixels": 9, "coverage": coverage, "median_abs_mm": median, "half_width": half_width}
    return {"name": name, "regions": {"ink": region}}


def test_strategy_that_measures_less_does_not_win_and_ties_are_named() -> None:
    # a: 5.0 of everything; b: overlaps with it; c: apart; d: more accurate, but measures half; e: nothing.
    entries = [
        *(entry("c", 5.3, 1.0), entry("a", 5.0, 0.995), entry("b", 5.15, 1.0)),
        *(entry("d", 1.0, 0.5), entry("e", None, 0.0)),
    ]
    assert best_strategies(entries, "ink") == ["a", "b"]
    table = strategy_table({"scene": entries}, "t")
    names, cells = (list(column.cells) for column in table.columns)
    expected = {"c": "5.30", "a": "5.00 =", "b": "5.15 =", "d": "1.00 (50 %)", "e": "-"}
    assert dict(zip(names, cells, strict=True)) == expected


def test_strategies_of_two_scenes_are_answered_in_json(call: Callable[..., Any]) -> None:
    small = ("--set", "camera.resolution=[48,36]", "--set", "sampling.samples=2", "--repeats", 2)
    words = ("ink", "step", "--strategies", "single,max-modulation", *small, "--json")
    status, out, err = call("strategies", *words)
    assert status == 0, err
    answer = json.loads(out)
    assert {(s["scene"], s["region"]) for s in answer["surfaces"]} >= {
        ("ink", "ink"),
        ("step", "step"),
    }
    assert all(set(s["best"]) <= {"single", "max-modulation"} for s in answer["surfaces"])
    assert call("strategies", "step", "--budget", "nothing")[0] == 2
