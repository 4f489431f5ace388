"""What the gate found, for continuous integration: JUnit XML, GitHub annotations, a history of runs."""

import json
import subprocess
from collections.abc import Iterable
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from evaluation.gate.regression import NOT_JUDGED
from fringebench.gate.regression_result import Regression
from fringebench.gate.wording import sentence, short_name
from scenes.support.atomic_file import replacing
from scenes.support.errors import FileError
from scenes.support.safe_parse import parse_json


def write_junit(result: Regression, path: str | Path) -> None:
    """Write JUnit XML: a test case for each judged figure, a failure for each that got worse."""
    counts = {"tests": str(len(result.rows)), "failures": str(len(result.failed)), "errors": "0"}
    suites = ET.Element("testsuites", counts)
    suite = ET.SubElement(suites, "testsuite", {"name": f"fringebench {result.decoder}", **counts})
    for row in result.rows:
        name = f"{row.region}: {short_name(row.metric)}"
        case = ET.SubElement(suite, "testcase", {"classname": row.case, "name": name, "time": "0"})
        if not row.comparison.passed:
            text = sentence(row, result.where(row))
            kind = {"message": text, "type": row.comparison.verdict}
            ET.SubElement(case, "failure", kind).text = text
    ET.indent(suites)
    with replacing(path) as temporary:
        temporary.write_bytes(ET.tostring(suites, encoding="utf-8", xml_declaration=True) + b"\n")


def github_annotations(result: Regression) -> Iterable[str]:
    """Workflow commands of GitHub Actions: an error for each region that failed, worst first, as only ten of a step are
    shown; a notice when all passed.
    """
    for failure in result.failures():
        # In a property, two more characters are markup than in the message.
        title = _data(f"{failure.worst.case} / {failure.worst.region}")
        title = title.replace(":", "%3A").replace(",", "%2C")
        yield f"::error title={title}::{_data(failure.sentence())}"
    if result.rows and result.passed:
        yield f"::notice title=fringebench::{_data(result.decoder)} passed {len(result.rows)} figures"


def _data(text: str) -> str:
    """Text escaped for the message of a workflow command."""
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def append_history(result: Regression, path: str | Path) -> list[dict[str, Any]]:
    """Append a run to a history, one line of JSON a run, and return all, oldest first; a file that is no history stays
    as it was.
    """
    runs = read_history(path)
    figures = {
        case: {
            region: {name: found.mean for name, found in metrics.items() if name not in NOT_JUDGED}
            for region, metrics in regions.items()
        }
        for case, regions in result.figures.items()
    }
    runs.append(
        {
            "time": datetime.now(UTC).isoformat(timespec="seconds"),
            "commit": _commit(),
            "decoder": result.decoder,
            "baseline": result.baseline,
            "passed": result.passed,
            "figures": figures,
        }
    )
    with replacing(path) as temporary:
        temporary.write_text(
            "".join(json.dumps(run, allow_nan=False) + "\n" for run in runs), "utf-8"
        )
    return runs


def read_history(path: str | Path) -> list[dict[str, Any]]:
    """All runs of a history; none where there is no file. Raises `FileError` for a file that is none."""
    file = Path(path)
    if not file.exists():
        return []
    try:
        runs = [parse_json(line) for line in file.read_text("utf-8").splitlines() if line.strip()]
    except (OSError, ValueError) as error:
        raise FileError(f"history '{path}' cannot be read: {error}") from error
    for run in runs:
        if not (isinstance(run, dict) and isinstance(run.get("figures"), dict)):
            raise FileError(f"'{path}' is no history of the gate: name another file")
    return runs


def _commit() -> str:
    """Short name of the commit in the working folder; empty outside a repository."""
    with suppress(OSError, subprocess.SubprocessError):
        words = ["git", "rev-parse", "--short", "HEAD"]
        done = subprocess.run(words, capture_output=True, text=True, timeout=5.0, check=False)
        if done.returncode == 0:
            return done.stdout.strip()
    return ""
