"""A stage whose rows change for equal inputs must raise its version: a small made corpus against its golden hashes.

``CONDVLN_UPDATE_GOLDEN=1 make test`` (or this file alone) writes the hashes again, once versions are raised, and the
versions into the draft of the benchmark.
"""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import pytest

from condvln.sources.source import hash_file
from jobs.benchmark import Benchmark
from jobs.pipeline import build_pipeline, code_versions, list_units
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


def test_a_benchmark_names_the_versions_of_the_stages(pytestconfig: pytest.Config) -> None:
    """Every draft follows the code. A final version is never changed, so that the next one needs a draft."""
    folder = pytestconfig.rootpath / "configs"
    named: dict[str, dict[str, int]] = {}
    for path in sorted(folder.glob("benchmark-*.yaml")):
        benchmark = Benchmark.read(path, check_roots=False)
        stages = code_versions(benchmark.config)
        if benchmark.file.draft and os.environ.get("CONDVLN_UPDATE_GOLDEN"):
            lines = "".join(f"  {name}: {version}\n" for name, version in stages.items())
            path.write_text(re.sub(r"(?m)^stages:\n(?:  \w+: \d+\n)+", f"stages:\n{lines}", path.read_text()))
            benchmark = Benchmark.read(path, check_roots=False)
        named[path.name] = benchmark.file.stages
        if benchmark.file.draft:
            assert benchmark.file.stages == stages, f"{path.name}: write it anew with CONDVLN_UPDATE_GOLDEN=1"
    assert stages in named.values(), (
        f"the code has other versions than the final benchmarks ({', '.join(named)}), which must stay as they are: "
        "copy the newest to the next version with 'draft: true', without 'release' and 'configuration', and run again "
        "with CONDVLN_UPDATE_GOLDEN=1"
    )
