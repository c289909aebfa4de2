"""Croissant 1.0 metadata (``croissant.json``), so that dataset tools can load the manifests directly."""

from __future__ import annotations

from typing import Any, Final

from condvln.export.report import ExportReport
from condvln.export.splits import SPLITS
from condvln.sources.family import FAMILIES

__all__ = ["croissant"]

_CONTEXT: Final[dict[str, Any]] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileObject": "cr:fileObject",
    "fileProperty": "cr:fileProperty",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "parentField": "cr:parentField",
    "path": "cr:path",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}

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


def croissant(report: ExportReport, name: str) -> dict[str, Any]:
    """Return the JSON-LD document of an export; every manifest is listed with its size and hash."""
    manifests = [f"manifest/{split}.jsonl" for split in SPLITS if report.episodes.get(split)]
    families = sorted({scene.split("/", 1)[0] for found in report.scenes.values() for scene in found})
    terms = [f"{FAMILIES[family].name}: {FAMILIES[family].terms}" for family in families if family in FAMILIES]
    credits = [FAMILIES[family].credit for family in families if family in FAMILIES]
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": name,
        "description": "Conditional vision-and-language navigation episodes, derived from the geometry of scenes.",
        "citeAs": "; ".join([f"{name}, snapshot {report.snapshot}", *credits]),
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
