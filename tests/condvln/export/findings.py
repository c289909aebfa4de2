"""What the linter finds in files that tests write."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

from condvln.export.validation import Finding


def write(path: Path, document: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(gzip.compress(json.dumps(document).encode(), mtime=0))
    return path


def codes(findings: list[Finding]) -> set[str]:
    return {finding.code for finding in findings}


def errors(findings: list[Finding]) -> list[Finding]:
    return [finding for finding in findings if finding.severity == "error"]
