"""What the gate found, in words."""

from evaluation.gate.regression import JudgedFigure

NAMES = {
    "bias_mm": "mean error",
    "systematic_mm": "systematic error",
    "wrong_order_fraction": "wrong fringe orders",
    "silent_fraction": "silent errors (valid, beyond 5 claimed sigmas)",
    "missing_fraction": "missing pixels",
    "invented_fraction": "unlit pixels declared valid",
    "beyond_1_sigma_fraction": "errors beyond 1 claimed sigma",
    "beyond_2_sigma_fraction": "errors beyond 2 claimed sigmas",
    "beyond_3_sigma_fraction": "errors beyond 3 claimed sigmas",
    "excess_sigma_mm": "claimed sigma above the actual error",
}


def short_name(metric: str) -> str:
    """Name of a figure without its unit, for tables.

    >>> short_name("wrong_order_fraction")
    'wrong order'
    """
    return metric.removesuffix("_mm").removesuffix("_fraction").replace("_", " ")


def scaled(metric: str) -> tuple[float, str]:
    """Factor and unit in which a figure is shown: micrometres, or percent.

    >>> scaled("bias_mm")
    (1000.0, 'µm')
    """
    return (1000.0, "µm") if metric.endswith("_mm") else (100.0, "%")


def sentence(row: JudgedFigure, where: str = "") -> str:
    """One judged figure as a sentence: case, region, what, from and to how much, and where (see
    `fringebench.gate.error_maps.place`).
    """
    test = row.comparison
    scale, unit = scaled(row.metric)
    # Two decimals: hundredths of a per cent, or 10 nm; adding 0.0 turns -0.0 into 0.0.
    figures = (row.old.mean, row.new.mean, abs(test.difference), test.margin, test.upper)
    old, new, change, margin, up = (f"{round(value * scale, 2) + 0.0:.2f}" for value in figures)
    moved = f"{NAMES.get(row.metric, row.metric)}: {old} {unit} -> {new} {unit}"
    if test.verdict == "worse":
        verdict = f"worse by {change} {unit}, {margin} {unit} allowed"
    elif test.verdict == "undecided":
        verdict = f"may be worse by up to {up} {unit}, {margin} {unit} allowed: give more seeds"
    else:
        verdict = f"{test.verdict} by {change} {unit}"
    place = f"; {where}" if where else ""
    return f"{row.case} / {row.region}: {moved}, {verdict}{place}"
