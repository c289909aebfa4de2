"""What the linter finds in files that tests write."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

from condvln.export.validation import Finding
from tests.strict_loader import read


def write(path: Path, document: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(gzip.compress(json.dumps(document).encode(), mtime=0))
    return path


def codes(findings: list[Finding]) -> set[str]:
    return {finding.code for finding in findings}


def errors(findings: list[Finding]) -> list[Finding]:
    return [finding for finding in findings if finding.severity == "error"]


def rxr_as_published(exported: Path) -> Any:
    """Our guide file of the test split with what RxR-VLN-CE's own have: timed words, a role, no geodesic."""
    document = read(exported / "rxr" / "test" / "test_guide.json.gz")
    for number, episode in enumerate(document["episodes"]):
        episode["info"] = {"role": "guide"}
        words = episode["instruction"]["instruction_text"].split()[:2]
        episode["instruction"] = {
            **episode["instruction"],
            "annotator_id": "0",
            "edit_distance": 0.08,
            "instruction_id": str(number),
            "timed_instruction": [{"word": word, "start_time": 1.0, "end_time": 1.5} for word in words],
        }
    return document


def bert_as_published(exported: Path, split: str = "test") -> Any:
    """A split of ours with word pieces of BERT, as ``<split>_bertidx`` files have them beside a vocabulary of words."""
    document = read(exported / "vlnce" / split / f"{split}.json.gz")
    for number, episode in enumerate(document["episodes"]):
        tokens = [101, 2065, 2045, 20_000 + number, 102]
        episode["instruction"]["instruction_tokens"] = tokens + [0] * (200 - len(tokens))
    return document
