"""The dataset card, a Hugging Face ``README.md``, and Croissant 1.0 metadata (``croissant.json``), with which dataset
tools load the manifests directly. All numbers come from the export's report.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from importlib.resources import files
from typing import Any, Final

import orjson
import yaml

from condvln.export.report import ExportReport
from condvln.export.splits import OBSERVED, SPLITS
from condvln.sources.family import FAMILIES, composed_datasets
from schemas.program import CATEGORIES

__all__ = ["croissant", "dataset_card"]

_NAME: Final = "CondVLN"

_SIZES: Final = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
_LARGEST: Final = "1M<n<10M"
_AXES: Final = (
    "category",
    "depth",
    "chain",
    "composition",
    "observability",
    "moves",
    "leads",
    "route",
    "words",
    "success_distance",
    "source",
)


def dataset_card(report: ExportReport) -> str:
    """Return the dataset card of an export; equal reports give equal text."""
    sections = [
        _front_matter(report),
        f"# {_NAME}",
        _introduction(report),
        "## Files",
        _FILES % (_R2R if report.r2r_episodes else "", _PLANS if report.pictures else ""),
        _meshes(report),
        "## Episodes",
        _counts(report),
        "## Examples",
        _examples(report),
        *_pictures(report),
        "## Balance",
        _balance(report),
        "## Bias",
        _bias(report),
        "## Licences",
        _licences(report),
        "## Datasheet",
        _datasheet(report),
    ]
    return "\n\n".join(sections) + "\n"


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


def _introduction(report: ExportReport) -> str:
    episodes, scenes = sum(report.episodes.values()), {scene for found in report.scenes.values() for scene in found}
    return (
        f"{episodes:,} navigation episodes in {len(scenes):,} indoor scenes whose instructions branch on what is "
        "there: “If there's a coffee table in the kitchen, head to the stool north of the dishwasher, otherwise go "
        "to the sink in the bathroom.” Every condition, target and distance was derived from the scene's geometry, "
        f"and each episode knows the goals of *all* its branches. Snapshot `{report.snapshot}`."
    )


_FILES: Final = """\
| path | content |
|---|---|
| `vlnce/<split>/` | stock R2R_VLNCE v1-3 episodes and dense ground truth; load in an unmodified VLN-CE |
| `ansr/<split>/` | the same with top-level `subgoals` (dataset type ANSR-v1) |
| `rxr/<split>/` | the same as RxR-VLN-CE guide files |
| `vlnce_looking/<split>/`, `ansr_looking/`, `rxr_looking/` | the same ids and texts; reference and truth are the \
looking path, which sees the evidence of each condition before it acts on it |
| `oracle/<split>/` | the oracle-linear twin: only the instruction differs, it tells the right branch alone |
%s| `manifest/<split>.jsonl` | programs, truths, gold leaf, goals of every leaf: never show it to an agent |
| `navmeshes/` | navmeshes built for scenes that ship none |
%s| `configs/` | configuration files for VLN-CE, habitat-lab and the agents that run on them |
| `export.json` | counts per cell, what was left out and why, SHA-256 of every file |
| `origin.json` | the configuration, the code's versions and the scenes that it was made of |

Positions are metres in Habitat's frame (+Y up, −Z north), quaternions `[x, y, z, w]`."""


_PLANS: Final = "| `pictures/` | the plans below |\n"
_R2R: Final = (
    "| `r2r/` | discrete R2R over Matterport viewpoints, of the scans of Matterport3D; each path has its text three "
    "times |\n"
)


def _meshes(report: ExportReport) -> str:
    text = (
        "Scene meshes are not included: get them from their sources and put them below `data/scene_datasets/`, each "
        "at the path that `scene_id` names."
    )
    composed = composed_datasets(scene for found in report.scenes.values() for scene in found)
    if composed:
        text += (
            f" Of {', '.join(composed)}, which come in parts, `condvln export CONFIG --compose data/scene_datasets` "
            "makes these files on your own disk, each with its navmesh; with `--own-navmesh` it is the one on which "
            "the episodes were placed."
        )
    return text


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
    if report.empty_splits:
        lines += ["", *(f"* `{split}` is empty: {why}." for split, why in report.empty_splits.items())]
    if report.r2r_episodes:
        lines += ["", f"Of these, {report.r2r_episodes:,} are also in the discrete R2R files."]
    return "\n".join(lines)


def _examples(report: ExportReport) -> str:
    """Return one text of each category, as it is in the files."""
    return "\n".join(
        f"* {category} (episode {report.examples[category][0]}): “{report.examples[category][1]}”"
        for category in CATEGORIES
        if category in report.examples
    )


def _pictures(report: ExportReport) -> list[str]:
    """Return the plan of one episode for each source, with its text."""
    if not report.pictures:
        return []
    said = (
        "Plans with the start, the ways to all leaves (the gold one green), their stops and what the conditions ask "
        "about, drawn as `condvln show --picture` draws any episode."
    )
    shown = (
        f"![plan of {path.rsplit('/', 1)[1].split('.')[0]}]({path})\n\n{text}" for path, text in report.pictures.items()
    )
    return ["## Pictures", said, *shown]


def _balance(report: ExportReport) -> str:
    lines = [
        "Within each split, source and category every gold leaf is equally frequent. Truths of conditions on one "
        "label in one type of room are evened as far as the pool allows; the share that is left (0 = even, 1 = the "
        "label tells the truth):",
        "",
        *(f"* {source}: {value:.3f}" for source, value in sorted(report.truth_imbalance.items())),
    ]
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


def _licences(report: ExportReport) -> str:
    used = sorted({scene.split("/", 1)[0] for found in report.scenes.values() for scene in found})
    lines = ["| source | terms | credit |", "|---|---|---|"]
    for family in used:
        known = FAMILIES.get(family)
        lines.append(_row([known.name, known.terms, known.credit]) if known else _row([family, "unknown", ""]))
    lines += [
        "",
        "Text and coordinates here are derived from these datasets; their terms apply to the use of this one.",
    ]
    return "\n".join(lines)


def _datasheet(report: ExportReport) -> str:
    return f"""\
* **Motivation.** Instructions that people give depend on what is found on the way; benchmarks of plain instructions
  can't tell an agent that checks a condition from one that guesses.
* **Composition.** One instance is an instruction, a start pose, a gold route with dense locations, and the goals of
  every branch. {_budget(report)} Nothing in it relates to people.
* **Collection.** Made by program from the sources' own annotations and geometry: relations by exact box and mesh
  distances, routes on Habitat navmeshes, text from a grammar that a parser reads back. Nothing was labelled by hand.
* **Preprocessing.** Candidates that break a rule (unreachable, ambiguous, near a threshold, too long) were dropped
  and counted.
* **Uses.** Evaluating and training vision-and-language navigation. Not a record of real homes' present state.
* **Known limits.** English text from a grammar; annotation of scans is incomplete, so absence is claimed only in
  rooms annotated completely enough; objects of unknown extent are used with more caution than others.
* **Distribution and maintenance.** Rebuilt when a source changes; ids are content hashes and stay; `CHANGELOG.md`
  tells what moved."""


def _budget(report: ExportReport) -> str:
    if report.least_steps == report.most_steps:
        return f"The step budget is {report.most_steps} actions."
    return (
        f"Step budgets are {report.least_steps} to {report.most_steps} actions, one an episode (`info.max_steps`), by\n"
        "  which `condvln evaluate` judges; stock evaluators give all episodes the largest."
    )


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


_FIELDS: Final = (
    ("episode_id", "sc:Integer", "id, made from the hash"),
    ("episode_hash", "sc:Text", "hash of the episode's content"),
    ("split", "sc:Text", "train, val_seen, val_unseen or test"),
    ("source", "sc:Text", "dataset that the scene is from"),
    ("scene_id", "sc:Text", "scene"),
    ("category", "sc:Text", "shape of the decision tree"),
    ("depth", "sc:Integer", "deepest THEN-nesting"),
    ("chain", "sc:Integer", "tests in the top chain"),
    ("composition", "sc:Text", "C0, C1 or C2: how rooms of conditions and leaves differ"),
    ("instruction_text", "sc:Text", "what the agent is told"),
    ("gold_leaf", "sc:Integer", "leaf that the truths of the conditions lead to"),
    ("success_distance", "sc:Float", "metres"),
    ("max_steps", "sc:Integer", "step budget"),
    ("geodesic_distance", "sc:Float", "start to goal, metres"),
    ("route_length", "sc:Float", "start to goal by way of the subgoals, metres"),
)


def croissant(report: ExportReport) -> dict[str, Any]:
    """Return the JSON-LD document of an export; every manifest is listed with its size and hash."""
    manifests = [f"manifest/{split}.jsonl" for split in SPLITS if report.episodes.get(split)]
    families = sorted({scene.split("/", 1)[0] for found in report.scenes.values() for scene in found})
    terms = [f"{FAMILIES[family].name}: {FAMILIES[family].terms}" for family in families if family in FAMILIES]
    credits = [FAMILIES[family].credit for family in families if family in FAMILIES]
    return {
        "@context": orjson.loads(files("condvln.export").joinpath("croissant_context.json").read_bytes()),
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
                "@id": f"{split}/{key}",
                "name": key,
                "description": description,
                "dataType": kind,
                "source": {"fileObject": {"@id": path}, "extract": {"column": key}},
            }
            for key, kind, description in _FIELDS
        ],
    }
