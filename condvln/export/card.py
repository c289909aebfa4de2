"""The dataset card, a Hugging Face ``README.md``, and Croissant 1.0 metadata (``croissant.json``), with which dataset
tools load the manifests directly. All numbers come from the export's report.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence, Set
from string import Template
from typing import Any, Final

import orjson
import yaml

from condvln.export.report import ExportReport
from condvln.export.splits import OBSERVED, SHAPE_AXES, SPLITS
from condvln.own_tables import own_rows, own_text
from condvln.sources.family import FAMILIES, composed_datasets
from schemas.program import CATEGORIES

__all__ = ["croissant", "dataset_card"]

_NAME: Final = "CondVLN"

_SIZES: Final = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
_LARGEST: Final = "1M<n<10M"
_AXES: Final = (*SHAPE_AXES, "success_distance", "source")


def dataset_card(report: ExportReport) -> str:
    """Return the dataset card of an export, ``dataset_card.md`` filled in; equal reports give equal text."""
    scenes = {scene for found in report.scenes.values() for scene in found}
    composed = composed_datasets(scenes)
    return Template(own_text("condvln.export", "dataset_card.md")).substitute(
        front_matter=_front_matter(report),
        episodes=f"{sum(report.episodes.values()):,}",
        scenes=f"{len(scenes):,}",
        snapshot=report.snapshot,
        r2r=_R2R if report.r2r_episodes else "",
        plans=_PLANS if report.pictures else "",
        composed=_COMPOSED % ", ".join(composed) if composed else "",
        counts=_counts(report),
        examples="\n".join(
            f"* {category} (episode {report.examples[category][0]}): “{report.examples[category][1]}”"
            for category in CATEGORIES  # one text of each, as it is in the files
            if category in report.examples
        ),
        pictures=_pictures(report),
        balance=_balance(report),
        bias=_bias(report),
        licences=_licences({scene.split("/", 1)[0] for scene in scenes}),
        budget=_budget(report),
    )


def _front_matter(report: ExportReport) -> str:
    total = sum(report.episodes.values())
    size = next((label for limit, label in _SIZES if total < limit), _LARGEST)
    filled = [split for split in SPLITS if report.episodes.get(split)]
    fields = {
        "pretty_name": _NAME,
        "language": [report.language],
        "license": "other",
        "license_name": "terms-of-the-sources",
        "task_categories": ["robotics"],
        "tags": ["vision-and-language-navigation", "embodied-ai", "habitat", "vln-ce", "conditional-instructions"],
        "size_categories": [size],
        "configs": [
            {
                "config_name": "episodes",
                "default": True,
                "version": _version(report),
                "data_files": [{"split": split, "path": f"manifest/{split}.jsonl"} for split in filled],
            }
        ],
    }
    return "---\n" + yaml.safe_dump(fields, sort_keys=False, allow_unicode=True) + "---"


def _version(report: ExportReport) -> str:
    """Return a version derived from the manifests' contents: the ``datasets`` library caches by version, not by
    contents.
    """
    hashes = [f"{path} {file.sha256}" for path, file in sorted(report.files.items()) if path.startswith("manifest/")]
    number = int(hashlib.sha256("\n".join(hashes).encode()).hexdigest()[:12], 16)
    return f"1.{number >> 24}.{number & 0xFFFFFF}"


_PLANS: Final = "| `pictures/` | the plans below |\n"
_R2R: Final = (
    "| `r2r/` | discrete R2R over Matterport viewpoints, of the scans of Matterport3D; each path has its text three "
    "times |\n"
)


_COMPOSED: Final = (
    " Of %s, which come in parts, `condvln export CONFIG --compose data/scene_datasets` makes these files on your own "
    "disk, each with its navmesh; with `--own-navmesh` it is the one on which the episodes were placed."
)


def _counts(report: ExportReport) -> str:
    splits = [split for split in SPLITS if report.episodes.get(split)]
    lines = [_row(["", *splits]), _row(["---", *["---:"] * len(splits)])]
    lines.append(_row(["episodes", *(f"{report.episodes[split]:,}" for split in splits)]))
    lines.append(_row(["scenes", *(f"{len(report.scenes[split]):,}" for split in splits)]))
    for axis in _AXES:
        values = sorted({value for split in splits for value in report.shapes.get(split, {}).get(axis, {})})
        for value in values:
            counts = [report.shapes.get(split, {}).get(axis, {}).get(value, 0) for split in splits]
            lines.append(_row([f"{axis.replace('_', ' ')}: {value}", *(f"{count:,}" for count in counts)]))
    lines += ["", f"Observability: {'; '.join(f'{name}: {what}' for name, what in OBSERVED.items())}."]
    lines += ["", "Oddness: how little the parts of an instruction have to do with each other; 0 for an errand."]
    if report.empty_splits:
        lines += ["", *(f"* `{split}` is empty: {why}." for split, why in report.empty_splits.items())]
    if report.r2r_episodes:
        lines += ["", f"Of these, {report.r2r_episodes:,} are also in the discrete R2R files."]
    return "\n".join(lines)


def _pictures(report: ExportReport) -> str:
    """Return the section with the plan of one episode for each source, with its text."""
    if not report.pictures:
        return ""
    said = (
        "Plans with the start, the ways to all leaves (the gold one green), their stops and what the conditions ask "
        "about, drawn as `condvln show --picture` draws any episode."
    )
    shown = (
        f"![plan of {path.rsplit('/', 1)[1].split('.')[0]}]({path})\n\n{text}" for path, text in report.pictures.items()
    )
    return "\n" + "\n\n".join(["## Pictures", said, *shown]) + "\n"


def _balance(report: ExportReport) -> str:
    lines = [f"* {source}: {value:.3f}" for source, value in sorted(report.truth_imbalance.items())]
    if report.left_out:
        left, pool = sum(report.left_out.values()), sum(report.episodes.values()) + sum(report.left_out.values())
        lines += ["", f"{left:,} of {pool:,} episodes are in no split:", ""]
        lines += [f"* {count:,} {reason}" for reason, count in sorted(report.left_out.items())]
    if report.lopsided:
        lines += ["", "Splits that could not be filled as the others are (`splits.scenes` gives them more scenes):", ""]
        lines += [f"* `{split}`: {what}" for split, what in report.lopsided.items()]
    short = report.shortfalls
    if short:
        lines += [
            "",
            "Cells with fewer episodes than asked for:",
            "",
            "| split | source | category | gold leaf | short |",
        ]
        lines.append("|---|---|---|---:|---:|")
        lines += [_row([c.split, c.source, c.category, str(c.gold_leaf), str(c.shortfall)]) for c in short]
    return "\n".join(lines)


def _bias(report: ExportReport) -> str:
    if report.bias is None:
        return "Not tested."
    lines = [
        "Guessers that do not see the scene, against chance (1 ÷ leaves). Those that learn are given other scenes "
        "only. Of a counterfactual group one episode is guessed at. Intervals are of 95 % and clustered by scene; "
        "p-values are one-sided and corrected for the number of tests.",
        "",
        f"Verdict: {report.bias.verdict()}.",
    ]
    if report.bias.findings:
        lines += ["", "| guesser | source | part | episodes | right | 95 % | chance | p |"]
        lines.append("|---|---|---|---:|---:|---:|---:|---:|")
        for guesser, source, part, episodes, right, low, high, chance, p in report.bias.overview():
            shares = (f"{right:.3f}", f"{low:.3f}–{high:.3f}", f"{chance:.3f}", f"{p:.3g}")
            lines.append(_row([str(guesser), str(source), str(part), f"{episodes:,}", *shares]))
    return "\n".join(lines)


def _licences(families: Set[str]) -> str:
    known = {family: FAMILIES.get(family) for family in sorted(families)}
    rows = [[one.name, one.terms, one.credit] if one else [family, "unknown", ""] for family, one in known.items()]
    return "\n".join(map(_row, rows))


def _budget(report: ExportReport) -> str:
    if report.least_steps == report.most_steps:
        return f"The step budget is {report.most_steps} actions."
    return (
        f"Step budgets are {report.least_steps} to {report.most_steps} actions, one an episode (`info.max_steps`), by\n"
        "  which `condvln evaluate` judges; stock evaluators give all episodes the largest."
    )


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def croissant(report: ExportReport) -> dict[str, Any]:
    """Return the JSON-LD document of an export; every manifest is listed with its size and hash."""
    manifests = [f"manifest/{split}.jsonl" for split in SPLITS if report.episodes.get(split)]
    families = sorted({scene.split("/", 1)[0] for found in report.scenes.values() for scene in found})
    terms = [f"{FAMILIES[family].name}: {FAMILIES[family].terms}" for family in families if family in FAMILIES]
    credits = [FAMILIES[family].credit for family in families if family in FAMILIES]
    return {
        "@context": orjson.loads(own_text("condvln.export", "croissant_context.json")),
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": _NAME,
        "description": "Conditional vision-and-language navigation episodes, derived from the geometry of scenes.",
        "citeAs": "; ".join([f"{_NAME}, snapshot {report.snapshot}", *credits]),
        "license": "; ".join(terms) or "unknown",
        "version": "1.0.0",
        "identifier": report.snapshot,
        "keywords": ["vision-and-language navigation", "embodied AI", "conditional instructions"],
        "distribution": [
            {
                "@type": "cr:FileObject",
                "@id": path,
                "name": path,
                "contentUrl": path,
                "contentSize": f"{report.files[path].bytes} B",
                "encodingFormat": "application/jsonlines",
                "sha256": report.files[path].sha256,
            }
            for path in manifests
        ],
        "recordSet": [_record_set(path) for path in manifests],
    }


def _record_set(path: str) -> dict[str, Any]:
    split = path.removeprefix("manifest/").removesuffix(".jsonl")
    return {
        "@type": "cr:RecordSet",
        "@id": split,
        "name": split,
        "description": f"Episodes of the split {split}, one a line.",
        "key": {"@id": f"{split}/episode_id"},
        "field": [
            {
                "@type": "cr:Field",
                "@id": f"{split}/{field['name']}",
                **field,
                "source": {"fileObject": {"@id": path}, "extract": {"column": field["name"]}},
            }
            for field in own_rows("condvln.export", "croissant_fields.csv")
        ],
    }
