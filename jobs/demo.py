"""``condvln demo``: the whole pipeline on synthetic scenes in four formats, or the scenes of one format alone."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Final

import yaml
from rich.console import Console

from condvln.evaluation.split import SplitOptions
from condvln.manifest import manifest_lines, manifest_path
from condvln.samples import make_samples
from jobs.agents import evidence_seen
from jobs.evaluate import EvaluationReport, Question, evaluate_predictions, walk_split
from jobs.explore import Exploration, explore
from jobs.generate import run_generate
from jobs.report import Report, print_report
from jobs.settings import export_folder
from jobs.show import show_episodes
from jobs.verify import verify_export
from jobs.workspace import published
from schemas.config import Config, Family, InstructionsConfig, RayConfig, SourceConfig, SplitsConfig
from schemas.program import CATEGORIES

__all__ = ["run_demo", "write_samples"]

FAMILIES: Final[tuple[Family, ...]] = ("replicacad", "procthor", "mp3d", "gibson")
"""Families of the paper's four sources. Of AI2-THOR it takes houses, which have no mesh, so that navmeshes are built
too."""
SHOWN: Final = 2
"""Number of instructions printed."""
PER_CATEGORY: Final = 10
"""Episodes per scene and category: enough to fill every category, few enough for two minutes."""
AGENTS: Final = ("perfect", "nearest", "wrong-branch")
FRACTIONS: Final = (0.5, 0.25, 0.25)
"""Shares of the splits: with so few scenes, a tenth of them would be no scene."""


def run_demo(out: Path, *, scenes: int, seed: int, workers: int, console: Console) -> int:
    """Make synthetic scenes; generate, export, show and prove episodes of these scenes; run the reference agents, and
    evaluate them. Returns the exit code.

    scenes : over all families together
    workers : number of Ray workers; with 1, the work is done in this process
    """
    began = time.monotonic()
    out = out.resolve()
    shares = [scenes // len(FAMILIES) + (k < scenes % len(FAMILIES)) for k in range(len(FAMILIES))]
    chosen = [(family, count) for family, count in zip(FAMILIES, shares, strict=True) if count]
    for k, (family, count) in enumerate(chosen):
        console.print(f"making {count} apartments as {family} in {out / 'scenes' / family}", highlight=False)
        # Other seeds, so that no apartment is there twice in two formats.
        make_samples(out / "scenes" / family, family=family, scenes=count, seed=seed * len(FAMILIES) + k)
    config = Config(
        name="demo",
        seed=seed,
        store=str(out / "store"),
        export=out / "export",
        sources=tuple(SourceConfig(family=family, root=out / "scenes" / family) for family, _ in chosen),
        instructions=InstructionsConfig(per_category=dict.fromkeys(CATEGORIES, PER_CATEGORY)),
        splits=SplitsConfig(fractions=FRACTIONS),
        ray=RayConfig(workers=workers, address="local"),
    )
    (out / "demo.yaml").write_text(config.model_dump_json(indent=1, exclude_defaults=True), encoding="utf-8")
    report = run_generate(config, console=console)
    for part in (report, show_episodes(config, sample=SHOWN, picture=out / "pictures")):
        print_report(part)
    proof = verify_export(config, out / "export")
    measured = _measure(config, out)
    files = tuple(out / "predictions" / f"{agent}.json" for agent in AGENTS) if measured is not None else ()
    page = explore(Exploration(out / "page", config.export, config, files, views=1)).document["page"]
    snapshot = published(config)
    closing = Report(
        {},
        [
            "",
            f"configuration  {out / 'demo.yaml'}, for condvln query, show, verify, …",
            f"tables         {out / 'store' / 'snapshots' / snapshot.snapshot_id}",
            f"episodes       {config.export}",
            f"predictions    {out / 'predictions'}",
            f"pictures       {out / 'pictures'}",
            f"the page       open {page}",
            f"done in {time.monotonic() - began:.0f} s",
        ],
    )
    print_report(proof if proof.exit_code else proof.lines[0])
    if measured is not None:
        print_report(measured)
    print_report(closing)
    return max(report.exit_code, proof.exit_code)


def _measure(config: Config, out: Path) -> EvaluationReport | None:
    """Run the reference agents on the largest split, and evaluate them. The training split is used only if the others
    are empty. Returns None if all are empty.
    """
    export = export_folder(config)
    sizes = {
        split: sum(1 for _ in manifest_lines(manifest_path(export, split))) for split in ("val_unseen", "test", "train")
    }
    split = max(sizes, key=lambda name: (sizes[name] > 0 and name != "train", sizes[name]))
    if not sizes[split]:
        return None
    roots = [source.root for source in config.sources]
    files = [out / "predictions" / f"{agent}.json" for agent in AGENTS]
    for agent, path in zip(AGENTS, files, strict=True):
        walk_split(export, split, agent, path, roots, config.seed)
    datasets = [f"{source.family}={source.root}" for source in config.sources]
    options = SplitOptions(navmesh_roots=tuple(roots), sees_of=evidence_seen(export, datasets, roots))
    asked = Question(export=export, split=split, predictions=tuple(files), options=options)
    found = evaluate_predictions(asked)
    return EvaluationReport(found.evaluations, found.tables[:1])


def write_samples(folder: Path, *, family: str, scenes: int, seed: int) -> Report:
    """Write `scenes` synthetic scenes under `folder`; the report ends with the source entry for a configuration."""
    made = make_samples(folder, family=family, scenes=scenes, seed=seed)
    source = {"family": made.family, **{key: str(path.resolve()) for key, path in made.parts.items()}}
    document = {
        "folder": str(made.folder),
        "scenes": len(made.scenes),
        "rooms": made.rooms,
        "objects": made.objects,
        "files": made.files,
        "bytes": made.bytes,
        "source": source,
    }
    lines = [
        f"{made.folder}: {len(made.scenes)} scenes, {made.rooms} rooms, {made.objects} objects; "
        f"{made.files} files, {made.bytes:,} bytes",
        "In a configuration:",
        *yaml.safe_dump({"sources": [source]}, sort_keys=False).splitlines(),
    ]
    return Report(document, lines)
