"""Write all files of an export simultaneously, in one pass over the rows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from condvln.export.axes import observability_class, route_class, words_class
from condvln.export.place_graphs import PLACES, Places
from condvln.export.r2r import Graphs, r2r_episode
from condvln.export.report import ExportReport, WrittenFile
from condvln.export.rows import Row
from condvln.export.scene_table import SceneTable
from condvln.export.splits import SPLITS
from condvln.export.tokens import Vocabulary
from condvln.export.variants import OracleText, ansr_bytes, oracle_text_of, rxr_instruction
from condvln.export.vlnce import (
    DocumentWriter,
    EncodedEpisode,
    document_writer,
    encode,
    ground_truth,
    instruction_json,
    scene_file,
    truth_writer,
)
from condvln.formats.streams import ByteStream, JsonArrayStream, atomic_copy, atomic_stream
from condvln.manifest import manifest_path, manifest_row
from schemas.program import BEARINGS, SHAPES

__all__ = ["ExportWriter", "Layout"]

_MP3D: Final = "mp3d"


@dataclass(frozen=True)
class Layout:
    """How episodes are written: formats, patterns, shards."""

    scene_patterns: dict[str, str]
    token_length: int
    sharded: bool
    snapshot: str


@dataclass
class _SplitFiles:
    """The open files of one split."""

    name: str
    truth: DocumentWriter
    manifest: ByteStream
    documents: dict[str, DocumentWriter] = field(default_factory=dict)
    """Files by variant; with shards, those of the current scene."""
    r2r: JsonArrayStream | None = None


class ExportWriter:
    """Writes rows scene by scene as they arrive.

    Files get their final names only when the block of :meth:`open` ends without error. The ground truth is the same for
    all variants and is copied then.
    """

    def __init__(
        self,
        out: Path,
        layout: Layout,
        vocabulary: Vocabulary,
        scenes: SceneTable,
        report: ExportReport,
        *,
        oracle_texts: OracleText | None = None,
        graphs: Graphs | None = None,
        show: Callable[[Row], object] | None = None,
    ) -> None:
        """Prepare to write below ``out``; ``show`` is called with each manifest row that is written."""
        self._out = out
        self._layout = layout
        self._vocabulary = vocabulary
        self._scenes = scenes
        self._report = report
        self._oracle_texts = oracle_texts
        self._graphs = graphs
        self._show = show
        self._variants = ("vlnce", "ansr", "rxr") if oracle_texts is None else ("vlnce", "ansr", "rxr", "oracle")
        self._splits: list[_SplitFiles] = []
        self._open = ExitStack()
        self._streams: list[ByteStream] = []
        self._r2r_left_out: Counter[str] = Counter()
        self._shards: set[str] = set()
        self._places = Places()
        self._shapes: dict[tuple[str, tuple[Any, ...]], int] = {}

    @contextmanager
    def open(self) -> Iterator[None]:
        """Return a context manager that holds all files of all splits open."""
        with self._open:
            self._splits = [self._opened(split) for split in SPLITS]
            yield
        for stream in self._streams:
            self._note(stream)
        self._report_shapes()
        self._copy_truths()
        with atomic_stream(self._out / PLACES) as stream:
            stream.write(self._places.pickled())
        self._note(stream)
        self._report.r2r_left_out = dict(sorted(self._r2r_left_out.items()))

    def _opened(self, split: str) -> _SplitFiles:
        truth = self._open.enter_context(truth_writer(self._out / self._truth_name("vlnce", split)))
        manifest = self._open.enter_context(atomic_stream(manifest_path(self._out, split)))
        files = _SplitFiles(split, truth, manifest)
        for variant in self._variants:
            path = self._out / variant / split / f"{self._stem(variant, split)}.json.gz"
            files.documents[variant] = self._open.enter_context(document_writer(path, self._vocabulary_of(variant)))
        self._streams += [truth.entries.stream, manifest, *(d.entries.stream for d in files.documents.values())]
        return files

    def _opened_r2r(self, split: str) -> JsonArrayStream:
        path = self._out / "r2r" / f"R2R_{split}.json"
        stream = self._open.enter_context(atomic_stream(path, closing=b"]\n"))
        stream.write(b"[")
        self._streams.append(stream)
        return JsonArrayStream(stream)

    def _vocabulary_of(self, variant: str) -> Vocabulary | None:
        """Return the vocabulary of a variant; None for RxR, whose loader has none."""
        return None if variant == "rxr" else self._vocabulary

    @staticmethod
    def _stem(variant: str, split: str) -> str:
        return f"{split}_guide" if variant == "rxr" else split

    def _truth_name(self, variant: str, split: str) -> str:
        return f"{variant}/{split}/{self._stem(variant, split)}_gt.json.gz"

    def add_scene(self, source: str, scene: str, rows: list[tuple[int, Row, Row]]) -> None:
        """Write the selected episodes of one scene, given as (split code, row of episodes, row of instructions)."""
        scene_id = scene_file(source, scene, self._layout.scene_patterns)
        path, shipped = self._scenes.navmesh_path(source, scene)
        for code in sorted({code for code, _, _ in rows}):
            files = self._splits[code]
            self._report.scenes[files.name].append(f"{source}/{scene}")
            mine = [(row, instruction) for at, row, instruction in rows if at == code]
            self._report.episodes[files.name] += len(mine)
            names = {"source": source, "split": files.name, "navmesh": path, "snapshot": self._layout.snapshot}
            with self._documents(files, source, scene) as documents:
                for row, instruction in mine:
                    self._add(files, documents, scene_id, names, row, instruction)
        graph = (self._graphs or {}).get(scene) if source == _MP3D else None
        self._places.add(scene_id, (row for _, row, _ in rows), None if graph is None else graph.graph)
        if rows and shipped:
            with atomic_stream(self._out / path) as stream:
                stream.write(self._scenes.navmesh(source, scene) or b"")
            self._note(stream)

    @contextmanager
    def _documents(self, files: _SplitFiles, source: str, scene: str) -> Iterator[dict[str, DocumentWriter]]:
        """Yield the open documents, by variant, to which the scene's episodes are written. They are the split's own
        files, or shards as in Habitat's ``content`` folders.
        """
        if not self._layout.sharded:
            yield files.documents
            return
        shards = {}
        with ExitStack() as stack:
            for variant in self._variants:
                path = self._shard(variant, files.name, source, scene)
                shards[variant] = stack.enter_context(document_writer(path, self._vocabulary_of(variant)))
            yield shards
        for writer in shards.values():
            self._note(writer.entries.stream)

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
        documents: dict[str, DocumentWriter],
        scene_id: str,
        names: dict[str, str],
        row: Row,
        instruction: Row,
    ) -> None:
        """Write one episode to all files of its split; `names` are those of its row in the manifest."""
        text, length = row["instruction_text"], self._layout.token_length
        tokens, count = self._vocabulary.padded_json(text, length)
        self._report.texts_cut += count > length
        episode = EncodedEpisode.of(row, scene_id)
        stock = episode.with_instruction(instruction_json(encode(text), tokens))
        documents["vlnce"].add(stock)
        documents["ansr"].add(ansr_bytes(stock, row))
        guide = rxr_instruction(row, files.name, self._report.language)
        documents["rxr"].add(episode.with_instruction(encode(guide)))
        if self._oracle_texts is not None:
            linear = oracle_text_of(self._oracle_texts, row, instruction)
            tokens = self._vocabulary.padded_json(linear, length)[0]
            documents["oracle"].add(episode.with_instruction(instruction_json(encode(linear), tokens)))
        truth = encode(ground_truth(row))
        files.truth.add(encode(str(row["episode_id"])) + b":" + truth)
        told = manifest_row(row, instruction, **names)
        files.manifest.write(encode(told) + b"\n")
        if self._show is not None:
            self._show(told)
        self._note_shape(names["source"], row, files.name)
        if self._graphs and names["source"] == _MP3D:
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

    def _note_shape(self, source: str, row: Row, split: str) -> None:
        category = row["category"]
        key = (
            source,
            category,
            row["composition"],
            row["observability"],
            row["evidence_in_view"],
            row["moves"],
            route_class(row["route_length"]),
            words_class(row["words"]),
            row["success_distance"],
        )
        self._shapes[split, key] = self._shapes.get((split, key), 0) + 1
        example = (row["episode_id"], row["instruction_text"])
        self._report.examples[category] = min(self._report.examples.get(category, example), example)
        self._report.most_steps = max(self._report.most_steps, row["max_steps"])
        self._report.least_steps = min(self._report.least_steps or row["max_steps"], row["max_steps"])

    def _report_shapes(self) -> None:
        """Report how many episodes of each split are of each source, category and class, in the order in which they
        were first written.
        """
        for (split, key), number in self._shapes.items():
            source, category, composition, observability, in_view, moves, route, words, distance = key
            shape = self._report.shapes.setdefault(split, {})
            for name, value in (
                ("source", source),
                ("category", category),
                ("composition", composition),
                ("depth", SHAPES[category].depth),
                ("chain", SHAPES[category].chain),
                ("observability", observability_class(observability, in_view) or "not told"),
                ("moves", moves),
                ("route", route),
                ("words", words),
                ("success_distance", distance),
            ):
                counts = shape.setdefault(name, {})
                counts[str(value)] = counts.get(str(value), 0) + number

    def _copy_truths(self) -> None:
        for split in SPLITS:
            written = self._report.files[self._truth_name("vlnce", split)]
            for variant in self._variants[1:]:
                name = self._truth_name(variant, split)
                atomic_copy(self._out / self._truth_name("vlnce", split), self._out / name)
                self._report.files[name] = written

    def _note(self, stream: ByteStream) -> None:
        name = stream.path.relative_to(self._out).as_posix()
        self._report.files[name] = WrittenFile(stream.size, stream.digest.hexdigest())


def _says_bearings(instruction: Row) -> bool:
    """Return whether an instruction has egocentric directions, which are true only at the start of its episode."""
    named = [*instruction["conditions"], *(move for leaf in instruction["leaves"] for move in leaf["moves"])]
    return any(one["qualifier"] is not None and one["qualifier"]["predicate"] in BEARINGS for one in named)
