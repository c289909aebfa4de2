"""The folder of the page. It holds scripts and styles, which are copied unchanged, and chunks of data; each scene has
its own chunks.

Chunks are classic scripts, since a browser loads no JSON from ``file://``, but it loads scripts. A chunk is
``explorer.receive("<name>", "<base64 of gzip of JSON>");``. The base64 alphabet holds no quote and no ``<``, so nothing
in the data can end the script.
"""

from __future__ import annotations

import base64
import gzip
import re
import shutil
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import orjson

from condvln.evaluation.metrics import metrics_of
from condvln.explorer.agents import OUTCOMES, AgentResults
from condvln.explorer.episode import episode_labels
from condvln.formats.streams import write_file
from schemas.base import Json
from schemas.errors import UsageError

__all__ = ["NAMED", "NUMBERS", "PAGE", "Columns", "Site", "chunk_bytes"]

PAGE: Final = "index.html"
DATA: Final = "data"
_PAGE_FILES: Final = files("condvln.explorer").joinpath("page")
PARTS: Final = tuple(sorted(path.name for path in _PAGE_FILES.iterdir()))
EPISODES_A_CHUNK: Final = 100
TEXTS_A_CHUNK: Final = 4000


class Site:
    """Writes the page into a folder, scene by scene: memory holds only the current scene, and one short entry for each
    episode so far.

    The page appears with :meth:`finish`. A folder that holds something else is left alone.

    Parameters
    ----------
    out : folder to write; one of a former page is replaced
    level : of the compression

    Raises
    ------
    UsageError : the folder holds other files
    """

    def __init__(self, out: Path, *, level: int = 6) -> None:
        self.out, self._level = out, level
        if out.exists() and not out.is_dir():
            raise UsageError("--out is a file", place=str(out), remedy="Name a folder.")
        if out.is_dir() and not _is_ours(out):
            raise UsageError(
                "the folder holds files that condvln explore did not write",
                place=str(out),
                remedy="Name a new or empty folder with --out.",
            )
        for path in (out / PAGE, *out.glob(".*.part")):
            path.unlink(missing_ok=True)
        for folder in (DATA, FRAMES):
            shutil.rmtree(out / folder, ignore_errors=True)
        (out / DATA).mkdir(parents=True, exist_ok=True)
        self._columns = Columns()
        self._scenes: list[Json] = []
        self._chunks: list[int] = []
        self._texts: list[str] = []
        self._text_chunks = 0

    def add_scene(
        self,
        source: str,
        scene_id: str,
        rows: Sequence[Mapping[str, Any]],
        documents: Iterable[Json],
        *,
        plan: Json,
        graph: Json | None = None,
        made: Json | None = None,
        walks: Mapping[str, Json] | None = None,
    ) -> None:
        """Add a scene with its episodes.

        Parameters
        ----------
        rows : manifest rows of its episodes
        documents : what `episode_document` makes of each of them
        graph : its relations; None where they are not known
        made : what became of its candidates, as `scene_yield` says it; None where only an export is known
        walks : by episode id, the walks of each agent by name
        """
        number = len(self._scenes)
        scene = {
            "source": source,
            "id": scene_id,
            "episodes": len(rows),
            "rooms": len(plan["rooms"]),
            "objects": len(plan["objects"]),
            "graph": graph is not None,
            **{name: made[name] for name in ("wanted", "placed", "reason") if made is not None},
        }
        self._scenes.append(scene)
        self._write(f"scene-{number}", {"source": source, "id": scene_id, **plan, "made": made})
        if graph is not None:
            self._write(f"graph-{number}", graph)
        chunk: list[Json] = []
        for row, document in zip(rows, documents, strict=True):
            if not chunk:
                self._chunks.append(len(self._columns))
            self._columns.add(row, number, len(document["frames"]))
            self._add_text(row["instruction_text"])
            chunk.append(document)
            if len(chunk) == EPISODES_A_CHUNK:
                self._episodes(chunk, walks or {})
                chunk = []
        if chunk:
            self._episodes(chunk, walks or {})

    def add_picture(self, name: str, data: bytes) -> str:
        """Write a PNG file and return its address, relative to the page. `name` has letters, digits and ``-`` only."""
        if not re.fullmatch(r"[a-zA-Z0-9-]+", name):
            raise ValueError(f"{name!r} is not the name of a picture")
        (self.out / FRAMES).mkdir(exist_ok=True)
        write_file(self.out / FRAMES / f"{name}.png", data)
        return f"{FRAMES}/{name}.png"

    def finish(
        self,
        title: str,
        *,
        snapshot: str = "",
        statistics: Json | None = None,
        agents: Sequence[AgentResults] = (),
        tables: Sequence[Json] = (),
    ) -> Path:
        """Write the data that cover all scenes, then the page itself. Return the path of the page."""
        self._write_texts()
        columns = self._columns.document()
        index = {
            "title": title,
            "snapshot": snapshot,
            "scenes": self._scenes,
            "chunks": self._chunks,
            "texts": {"size": TEXTS_A_CHUNK, "chunks": self._text_chunks},
            "outcomes": list(OUTCOMES),
            "metrics": [[metric.key, metric.heading, metric.kind] for metric in metrics_of("walks")],
            "agents": [_agent(name, own, columns["columns"]["id"]) for name, own in _by_name(agents).items()],
            **columns,
        }
        self._write("index", index)
        self._write("statistics", statistics or {})
        plotted = [[metric.key, metric.heading] for metric in metrics_of("plots")]
        self._write("agents", {"tables": list(tables), "measures": plotted})
        for name in PARTS:
            write_file(self.out / (PAGE if name == "page.html" else name), _PAGE_FILES.joinpath(name).read_bytes())
        return self.out / PAGE

    def _episodes(self, documents: list[Json], walks: Mapping[str, Json]) -> None:
        number = len(self._chunks) - 1
        self._write(f"episodes-{number}", documents)
        self._write(f"walks-{number}", {one["id"]: walks[one["id"]] for one in documents if one["id"] in walks})

    def _add_text(self, text: str) -> None:
        self._texts.append(text)
        if len(self._texts) == TEXTS_A_CHUNK:
            self._write_texts()

    def _write_texts(self) -> None:
        if self._texts:
            self._write(f"texts-{self._text_chunks}", self._texts)
            self._text_chunks += 1
            self._texts = []

    def _write(self, name: str, document: Any) -> None:
        write_file(self.out / DATA / f"{name}.js", chunk_bytes(name, document, self._level))


FRAMES: Final = "frames"
"""Folder of pictures along gold paths."""


def _is_ours(out: Path) -> bool:
    """Return whether a folder is empty, or holds only a page of the explorer. The page may be half written."""
    page, data = out / PAGE, out / DATA
    if page.exists() and not (page.is_file() and b"condvln-explorer" in page.read_bytes()[:2000]):
        return False
    names = {_whole(path.name) for path in out.iterdir()} - {PAGE, DATA, FRAMES, *PARTS}
    chunks = data.iterdir() if data.is_dir() else ()
    return not names and all(re.fullmatch(r"[a-z]+(-\d+)?\.js", _whole(path.name)) for path in chunks)


def _whole(name: str) -> str:
    """Return the name that a file gets when it is complete; a killed writer leaves it under another name."""
    part = re.fullmatch(r"\.(.+)\.part", name)
    return part[1] if part else name


def _by_name(agents: Sequence[AgentResults]) -> dict[str, list[AgentResults]]:
    """Return the results by the agent's name, one result for each split on which the agent was scored."""
    found: dict[str, list[AgentResults]] = {}
    for agent in agents:
        found.setdefault(agent.name, []).append(agent)
    return found


def _agent(agent: str, results: Sequence[AgentResults], ids: Sequence[str]) -> Json:
    episodes = {name: row for one in results for name, row in one.episodes.items()}
    found = [episodes.get(name) for name in ids]
    measures = [*next((scores for _, scores in episodes.values()), {})]
    return {
        "name": agent,
        "splits": [one.split for one in results],
        "outcome": [0 if one is None else one[0] for one in found],
        "scores": {name: [None if one is None else one[1][name] for one in found] for name in measures},
    }


_LEVEL: Final = 6
_NAME: Final = re.compile(r"[a-z]+(-\d+)?")


def chunk_bytes(name: str, document: Any, level: int = _LEVEL) -> bytes:
    """Return the bytes of the script that holds a chunk; equal documents give equal bytes."""
    if not _NAME.fullmatch(name):
        raise ValueError(f"{name!r} is not the name of a chunk")
    packed = gzip.compress(orjson.dumps(document, option=orjson.OPT_SERIALIZE_NUMPY), level, mtime=0)
    return b'explorer.receive("%s", "%s");\n' % (name.encode(), base64.b64encode(packed))


NAMED: Final = ("split", "source", "category", "composition", "observability")
"""Columns of names. A null is the name "unknown"."""
NUMBERS: Final = ("depth", "chain", "moves", "words", "route_length", "geodesic_distance")
UNKNOWN: Final = "unknown"


class Columns:
    """Collects one entry per episode."""

    def __init__(self) -> None:
        self._names: dict[str, dict[str, int]] = {name: {} for name in (*NAMED, "label", "predicate")}
        names = ("id", "scene", "group", "pictures", "gold_label", "untrue", *NAMED, *NUMBERS)
        self._values: dict[str, list[Any]] = {name: [] for name in names}
        self._labels: tuple[list[int], list[int]] = ([0], [])
        self._predicates: tuple[list[int], list[int]] = ([0], [])
        self._groups: dict[tuple[int, str], int] = {}

    def __len__(self) -> int:
        return len(self._values["id"])

    def add(self, row: Mapping[str, Any], scene: int, pictures: int = 0) -> None:
        """Add an episode by its manifest row; `scene` is the number of its scene, `pictures` how many are shown."""
        values = self._values
        values["id"].append(str(row["episode_id"]))
        values["scene"].append(scene)
        values["pictures"].append(pictures)
        group = row["group_id"]
        # A group is within one scene, and its id is a name of that scene only.
        values["group"].append(-1 if group is None else self._groups.setdefault((scene, group), len(self._groups)))
        values["untrue"].append(sum(not one["truth"] for one in row["program"]["conditions"]))
        values["gold_label"].append(
            self._number("label", row["program"]["leaves"][row["gold_leaf"]]["moves"][-1]["label"])
        )
        for name in NAMED:
            values[name].append(self._number(name, self._named(row, name)))
        for name in NUMBERS:
            value = row[name]
            values[name].append(round(value, 2) if isinstance(value, float) else value)
        self._extend(self._labels, "label", episode_labels(row))
        asked = {
            "presence" if one["qualifier"] is None else one["qualifier"]["predicate"]
            for one in row["program"]["conditions"]
        }
        self._extend(self._predicates, "predicate", sorted(asked))

    def document(self) -> dict[str, Any]:
        """Return ``columns``, one entry per episode; ``names``, to which the numbers in the columns refer; ``lists``,
        the labels and predicates of all episodes, and the offsets at which those of each episode begin; and ``groups``,
        the number of counterfactual groups.
        """
        return {
            "names": {column: [*names] for column, names in self._names.items()},
            "columns": self._values,
            "lists": {
                "label": {"offsets": self._labels[0], "values": self._labels[1]},
                "predicate": {"offsets": self._predicates[0], "values": self._predicates[1]},
            },
            "groups": len(self._groups),
        }

    @staticmethod
    def _named(row: Mapping[str, Any], name: str) -> str:
        if name == "observability" and row[name] == "O0" and row.get("evidence_in_view"):
            return "O0f"
        return str(row[name]) if row[name] is not None else UNKNOWN

    def _number(self, column: str, name: str) -> int:
        names = self._names[column]
        return names.setdefault(name, len(names))

    def _extend(self, lists: tuple[list[int], list[int]], column: str, names: list[str]) -> None:
        lists[1].extend(self._number(column, name) for name in names)
        lists[0].append(len(lists[1]))
