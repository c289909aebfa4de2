"""A stage whose rows change for equal inputs must raise its version: a small made corpus against its golden hashes.

``CONDVLN_UPDATE_GOLDEN=1 make test`` (or this file alone) writes the hashes again, once versions are raised.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

from condvln.sources.source import hash_file
from jobs.pipeline import build_pipeline, list_units
from jobs.report import Report
from schemas.config import Config
from tests.fingerprint import compare, fingerprints

GOLDEN = Path(__file__).parent / "golden_stages.json"


def test_versions_are_raised_when_rows_change(made_run: tuple[Config, Report]) -> None:
    config, _ = made_run
    found = fingerprints(build_pipeline(config), list_units(config, hash_file))
    if os.environ.get("CONDVLN_UPDATE_GOLDEN"):
        GOLDEN.write_text(json.dumps(found, indent=1, sort_keys=True) + "\n")
    drift = compare(json.loads(GOLDEN.read_text()), found)
    assert not drift.unbumped, "rows changed under an equal key: raise the stage's version in jobs/stages/"
    assert not drift.outdated, "keys changed: write the golden file again with CONDVLN_UPDATE_GOLDEN=1"
