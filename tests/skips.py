"""Reasons for which a test may be skipped. Any other skip fails: a test that never runs is no evidence."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Generator
from typing import Any

import pytest

REASONS = (
    # Data that may not be shared. CONTRIBUTING.md says how to get it.
    r"no real datasets here: ",
    r"no \w+ in /",
    r"no \w+ among the real datasets",
    r"no scenes of \w+ here: ",
    r"the published lists are not here to compare with",
    # Libraries of an environment of their own, in which make agents runs these tests.
    r"(transformers|trl|torch|openenv|inspect-ai) is absent: make agents installs it",
    # A browser, which is installed by make browser.
    r"make browser runs the tests of the page",
    # The machine.
    r"needs \d+ GiB of free memory",
    r"only Linux gives the name of an open file",
    r"no /dev/full here",
    r"the system does not say how much memory a process holds",
    # A run within a run.
    r"the outer run does this",
    r"this is that run",
)
_KNOWN = re.compile("|".join(f"(?:{reason})" for reason in REASONS))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, Any, Any]:
    report = yield
    if report.skipped and not hasattr(report, "wasxfail"):
        reason = _reason(report)
        if not _KNOWN.match(reason):
            report.outcome = "failed"
            report.longrepr = (
                f"{reason}\nThis reason is not in tests/skips.py: make the test run, or add the reason there."
            )
    return report


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """How many tests were skipped for each reason."""
    reasons = Counter(_reason(report) for report in terminalreporter.stats.get("skipped", ()))
    for reason, number in sorted(reasons.items()):
        terminalreporter.write_line(f"{number} skipped: {reason}")


def _reason(report: Any) -> str:
    text = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    return str(text).removeprefix("Skipped: ")
