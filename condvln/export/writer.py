"""Write all files of an export simultaneously, in one pass over the rows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from condvln.export.place_graphs import PLACES, Places
from condvln.export.report import ExportReport, WrittenFile
from condvln.export.splits import SPLITS, observability_class, oddness_class, route_class, words_class
from condvln.export.tables import SPLITS_TABLE, Row, SceneTable, splits_table
from condvln.export.tokens import TOKEN_LENGTH, Vocabulary, padded
from condvln.export.viewpoints import FAMILY, Graphs, r2r_episode
from condvln.export.vlnce import (
    ansr_episode,
    document_stream,
    encode,
    ground_truth,
    looking_episode,
    looking_truth,
    oracle_episode,
    rxr_episode,
    scene_file,
    truth_stream,
    vlnce_episode,
)
from condvln.formats.streams import ByteStream, JsonArrayStream, atomic_copy, atomic_stream
from condvln.manifest import manifest_path, manifest_row
from schemas.program import BEARINGS, SHAPES

__all__ = ["ExportWriter", "OracleText"]

_STOCK: Final = ("vlnce", "ansr", "rxr")
_LOOKING: Final = "_looking"
"""End of the names of the variants whose reference is the looking path."""

OracleText = Callable[[Row, Row], str]
"""Makes the linear text of an episode, from its row of the episodes table and that of its instruction."""


@dataclass
class _SplitFiles:
    """The open files of one split."""

    name: str
    truths: dict[str, JsonArrayStream]
    """Ground truths along the direct path, and under `_LOOKING` along the looking path."""
    manifest: ByteStream
    documents: dict[str, JsonArrayStream] = field(default_factory=dict)
    """Files by variant; with shards, those of the current scene."""
    r2r: JsonArrayStream | None = None


class ExportWriter:
    """Writes rows scene by scene as they arrive.

    Files get their final names only when the block of :meth:`open` ends without error. The ground truth of a path
    is the same for all its variants and is copied then.
    """

    def __init__(
        self,
        out: Path,
        vocabulary: Vocabulary,
        scenes: SceneTable,
        report: ExportReport,
        *,
        sharded: bool = False,
        oracle_text: OracleText | None = None,
        graphs: Graphs | None = None,
        show: Callable[[Row], object] | None = None,
    ) -> None:
        """Prepare to write below ``out``, with a file a scene if ``sharded``; ``show`` is called with each manifest row
        that is written.
        """
        self._out = out
        self._sharded = sharded
        self._vocabulary = vocabulary
        self._scenes = scenes
        self._report = report
        self._oracle_text = oracle_text
        self._graphs = graphs
        self._show = show
        direct = _STOCK if oracle_text is None else (*_STOCK, "oracle")
        self._variants = (*direct, *(f"{variant}{_LOOKING}" for variant in _STOCK))
        self._splits: list[_SplitFiles] = []
        self._open = ExitStack()
        self._streams: list[ByteStream] = []
        self._r2r_left_out: Counter[str] = Counter()
        self._shards: set[str] = set()
        self._places = Places()
        self._chosen: list[tuple[int, str]] = []

    @contextmanager
    def open(self) -> Iterator[None]:
        """Return a context manager that holds all files of all splits open."""
        with self._open:
            self._splits = [self._opened(split) for split in SPLITS]
            yield
        for stream in self._streams:
            self._note(stream)
        self._copy_truths()
        with atomic_stream(self._out / PLACES) as stream:
            stream.write(self._places.pickled())
        self._note(stream)
        with atomic_stream(self._out / SPLITS_TABLE) as stream:
            stream.write(splits_table(self._chosen))
        self._note(stream)
        self._report.r2r_left_out = dict(sorted(self._r2r_left_out.items()))

    def _opened(self, split: str) -> _SplitFiles:
        truths = {
            path: self._open.enter_context(truth_stream(self._out / self._truth_name(f"vlnce{path}", split)))
            for path in ("", _LOOKING)
        }
        manifest = self._open.enter_context(atomic_stream(manifest_path(self._out, split)))
        files = _SplitFiles(split, truths, manifest)
        for variant in self._variants:
            path = self._out / variant / split / f"{self._stem(variant, split)}.json.gz"
            files.documents[variant] = self._open.enter_context(document_stream(path, self._vocabulary_of(variant)))
        opened = (*truths.values(), *files.documents.values())
        self._streams += [manifest, *(each.stream for each in opened)]
        return files

    def _opened_r2r(self, split: str) -> JsonArrayStream:
        path = self._out / "r2r" / f"R2R_{split}.json"
        stream = self._open.enter_context(atomic_stream(path, closing=b"]\n"))
        stream.write(b"[")
        self._streams.append(stream)
        return JsonArrayStream(stream)

    def _vocabulary_of(self, variant: str) -> Vocabulary | None:
        """Return the vocabulary of a variant; None for RxR, whose loader has none."""
        return None if variant.startswith("rxr") else self._vocabulary

    @staticmethod
    def _stem(variant: str, split: str) -> str:
        return f"{split}_guide" if variant.startswith("rxr") else split

    def _truth_name(self, variant: str, split: str) -> str:
        return f"{variant}/{split}/{self._stem(variant, split)}_gt.json.gz"

    def add_scene(self, source: str, scene: str, rows: list[tuple[int, Row, Row]]) -> None:
        """Write the selected episodes of one scene, given as (split code, row of episodes, row of instructions)."""
        scene_id = scene_file(source, scene)
        path, shipped = self._scenes.navmesh_path(source, scene)
        for code in sorted({code for code, _, _ in rows}):
            files = self._splits[code]
            self._report.scenes[files.name].append(f"{source}/{scene}")
            mine = [(row, instruction) for at, row, instruction in rows if at == code]
            self._report.episodes[files.name] += len(mine)
            names = {"source": source, "split": files.name, "navmesh": path, "snapshot": self._report.snapshot}
            with self._documents(files, source, scene) as documents:
                for row, instruction in mine:
                    self._add(files, documents, scene_id, names, row, instruction)
        graph = (self._graphs or {}).get(scene) if source == FAMILY else None
        self._places.add(scene_id, (row for _, row, _ in rows), None if graph is None else graph.graph)
        if rows and shipped:
            with atomic_stream(self._out / path) as stream:
                stream.write(self._scenes.navmesh(source, scene) or b"")
            self._note(stream)

    @contextmanager
    def _documents(self, files: _SplitFiles, source: str, scene: str) -> Iterator[dict[str, JsonArrayStream]]:
        """Yield the open documents, by variant, to which the scene's episodes are written. They are the split's own
        files, or shards as in Habitat's ``content`` folders.
        """
        if not self._sharded:
            yield files.documents
            return
        shards = {}
        with ExitStack() as stack:
            for variant in self._variants:
                path = self._shard(variant, files.name, source, scene)
                shards[variant] = stack.enter_context(document_stream(path, self._vocabulary_of(variant)))
            yield shards
        for shard in shards.values():
            self._note(shard.stream)

    def _shard(self, variant: str, split: str, source: str, scene: str) -> Path:
        folder = f"{variant}/{split}/content"
        name = f"{folder}/{quote(scene, safe='')}.json.gz"
        if name in self._shards:  # another source has a scene of this name
            name = f"{folder}/{source}-{quote(scene, safe='')}.json.gz"
        self._shards.add(name)
        return self._out / name

    def _add(
        self,
        files: _SplitFiles,
        documents: dict[str, JsonArrayStream],
        scene_id: str,
        names: dict[str, str],
        row: Row,
        instruction: Row,
    ) -> None:
        """Write one episode to all files of its split; `names` are those of its row in the manifest."""
        tokens = self._vocabulary.encode(row["instruction_text"])
        self._report.texts_cut += len(tokens) > TOKEN_LENGTH
        stock = vlnce_episode(row, scene_id, padded(tokens))
        made = {
            "vlnce": stock,
            "ansr": ansr_episode(stock, row),
            "rxr": rxr_episode(stock, row, files.name, self._report.language),
        }
        for variant, episode in made.items():
            documents[variant].entry(encode(episode))
            if row["looking_path"]:
                documents[f"{variant}{_LOOKING}"].entry(encode(looking_episode(episode, row)))
        if self._oracle_text is not None:
            text = self._oracle_text(row, instruction)
            documents["oracle"].entry(encode(oracle_episode(stock, text, self._vocabulary.padded(text))))
        name = encode(str(row["episode_id"])) + b":"
        files.truths[""].entry(name + encode(ground_truth(row)))
        if row["looking_path"]:
            files.truths[_LOOKING].entry(name + encode(looking_truth(row)))
        else:
            self._report.looking_left_out += 1
        line = manifest_row(row, instruction, **names)
        files.manifest.write(encode(line) + b"\n")
        if self._show is not None:
            self._show(line)
        self._count(names["source"], row, files.name)
        self._chosen.append((row["episode_id"], files.name))
        if self._graphs and names["source"] == FAMILY:
            self._add_r2r(files, row, instruction)

    def _add_r2r(self, files: _SplitFiles, row: Row, instruction: Row) -> None:
        graph = (self._graphs or {}).get(row["scene_id"])
        found: dict[str, Any] | str = "no connectivity graph of its scan" if graph is None else r2r_episode(row, graph)
        if _says_bearings(instruction):
            found = "it says what lies left or right of a start that is no viewpoint"
        if isinstance(found, str):
            self._r2r_left_out[found] += 1
            return
        # opened with the first path of any split, so that exports without paths have no such files
        if files.r2r is None:
            for each in self._splits:
                each.r2r = self._opened_r2r(each.name)
        assert files.r2r is not None
        files.r2r.entry(encode(found))
        self._report.r2r_episodes += 1

    def _count(self, source: str, row: Row, split: str) -> None:
        """Count an episode of a split by its source, category and classes."""
        category = row["category"]
        shapes = self._report.shapes.setdefault(split, {})
        for name, value in (
            ("source", source),
            ("category", category),
            ("composition", row["composition"]),
            ("oddness", oddness_class(row["oddness"])),
            ("depth", SHAPES[category].depth),
            ("chain", SHAPES[category].chain),
            ("observability", observability_class(row["observability"], row["evidence_in_view"]) or "not told"),
            ("moves", row["moves"]),
            ("leads", row["leads"]),
            ("route", route_class(row["route_length"])),
            ("words", words_class(row["words"])),
            ("success_distance", row["success_distance"]),
        ):
            counts = shapes.setdefault(name, {})
            counts[str(value)] = counts.get(str(value), 0) + 1
        example = (row["episode_id"], row["instruction_text"])
        self._report.examples[category] = min(self._report.examples.get(category, example), example)
        self._report.most_steps = max(self._report.most_steps, row["max_steps"])
        self._report.least_steps = min(self._report.least_steps or row["max_steps"], row["max_steps"])

    def _copy_truths(self) -> None:
        for split in SPLITS:
            for variant in self._variants:
                name = self._truth_name(variant, split)
                source = self._truth_name(f"vlnce{_LOOKING}" if variant.endswith(_LOOKING) else "vlnce", split)
                if name != source:
                    atomic_copy(self._out / source, self._out / name)
                    self._report.files[name] = self._report.files[source]

    def _note(self, stream: ByteStream) -> None:
        name = stream.path.relative_to(self._out).as_posix()
        self._report.files[name] = WrittenFile(stream.size, stream.digest.hexdigest())


def _says_bearings(instruction: Row) -> bool:
    """Return whether an instruction has egocentric directions, which are true only at the start of its episode."""
    named = [*instruction["conditions"], *(move for leaf in instruction["leaves"] for move in leaf["moves"])]
    return any(one["qualifier"] is not None and one["qualifier"]["predicate"] in BEARINGS for one in named)
