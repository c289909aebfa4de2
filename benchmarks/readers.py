"""Readers of all families: scenes and MB per second, and the memory that files of 100 MB take.

Speed is measured on made scenes (CONDVLN_BENCH_SCENES of them a family, 20 by default) and, where CONDVLN_REAL_DATA (or
``shared/data`` beside the checkout) names real ones, on those. Listing hashes what a scene reads and looks into it;
reading makes the scene. Memory is the peak of a process of its own that lists and reads one file of 100 MB: an answer
that takes more than 5 times the file's size is reported, and ends the benchmark with an exit code of 1.
"""

from __future__ import annotations

import gzip
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from condvln.samples import FAMILIES, make_samples
from condvln.sources.registry import open_source
from schemas.errors import InputError

BIG: Final = 100 << 20
LIMIT: Final = 5.0
"""Target: most bytes of memory per byte of file, including the interpreter and its libraries."""

MB: Final = 1 << 20

FLAGS: Final = dict.fromkeys(
    (
        *("isInteractable", "toggleable", "isToggled", "breakable", "isBroken", "canFillWithLiquid"),
        *("isFilledWithLiquid", "dirtyable", "isDirty", "canBeUsedUp", "isUsedUp", "cookable", "isCooked"),
        *("isHeatSource", "isColdSource", "sliceable", "isSliced", "isPickedUp", "isMoving", "visible"),
    ),
    False,
)
"""Fields that real metadata has for every object and that are not read; an object has 1.9 kB there."""


def main() -> None:
    """Print both tables."""
    print(f"{'source':26}{'scenes':>8}{'MB':>8}{'list, s':>9}{'read, s':>9}{'scenes/s':>10}{'MB/s':>8}")
    with tempfile.TemporaryDirectory() as name:
        for family in sorted(FAMILIES):
            folder = Path(name) / family
            make_samples(folder, family, int(os.environ.get("CONDVLN_BENCH_SCENES", "20")))
            _speed(f"{family}, made", family, folder)
    data = Path(os.environ.get("CONDVLN_REAL_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
    for family in sorted(FAMILIES):
        if (data / family).is_dir() and family != "robothor":
            _speed(f"{family}, real", family, data / family)
    print(f"\n{'file':26}{'MB':>8}{'list, s':>9}{'read, s':>9}{'MB/s':>8}{'objects':>9}{'peak, MB':>10}{'× file':>8}")
    with tempfile.TemporaryDirectory() as name:
        over = [kind for kind in BIG_FILES if _memory(kind, Path(name) / kind.replace(" ", "_")) > LIMIT]
    if over:
        raise SystemExit(f"more than {LIMIT:g} times the file's size: {', '.join(over)}")


def _speed(label: str, family: str, root: Path) -> None:
    """Print one line for all scenes of a dataset; those that can't be read count as scenes and are named."""
    begun = time.perf_counter()
    handles = open_source(family, root).handles()
    listed = time.perf_counter() - begun
    source, refused = open_source(family, root), 0
    begun = time.perf_counter()
    for handle in handles:
        try:
            source.read(handle.scene_id)
        except InputError:
            refused += 1
    read = time.perf_counter() - begun
    megabytes = sum(i.size for handle in handles for i in handle.inputs) / MB
    note = f"  ({refused} refused)" if refused else ""
    print(
        f"{label:26}{len(handles):8}{megabytes:8.1f}{listed:9.2f}{read:9.2f}"
        f"{len(handles) / (listed + read):10.1f}{megabytes / (listed + read):8.1f}{note}",
        flush=True,
    )


def _memory(kind: str, folder: Path) -> float:
    """Print one line for a large file, read in its own process. Return peak memory divided by the size of the file."""
    folder.mkdir()
    family, scene_id, path = BIG_FILES[kind](folder)
    size = path.stat().st_size
    code = f"from benchmarks.readers import child; child({family!r}, {str(folder)!r}, {scene_id!r})"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    answer = json.loads(run.stdout)
    unpacked = max(size, BIG)  # of a packed file the text counts
    ratio = answer["peak"] / unpacked
    print(
        f"{kind:26}{size / MB:8.1f}{answer['list']:9.2f}{answer['read']:9.2f}"
        f"{unpacked / MB / (answer['list'] + answer['read']):8.1f}{answer['objects']:9}"
        f"{answer['peak'] / MB:10.0f}{ratio:8.2f}  {answer['refused']}",
        flush=True,
    )
    path.unlink()
    return float(ratio)


def child(family: str, root: str, scene_id: str) -> None:
    """List one dataset and read one of its scenes; print seconds, objects and peak memory as JSON."""
    begun = time.perf_counter()
    source, refused, objects = open_source(family, Path(root), scenes=[scene_id]), "", 0
    (handle,) = source.handles()
    listed = time.perf_counter()
    try:
        objects = len(source.read(scene_id).objects)
    except InputError as error:
        refused = f"refused: {error.what}"
    read = time.perf_counter()
    answer = {"list": listed - begun, "read": read - listed, "objects": objects, "peak": _peak(), "refused": refused}
    print(json.dumps(answer | {"fault": str(handle.fault or "")}))


def _peak() -> int:
    """Return the peak memory of this process in bytes. Linux has another count, which a child inherits from its
    parent."""
    status = Path("/proc/self/status")
    if status.is_file():
        return next(int(line.split()[1]) << 10 for line in status.read_text().splitlines() if line[:6] == "VmHWM:")
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << (0 if sys.platform == "darwin" else 10)


def _house(folder: Path) -> tuple[str, str, Path]:
    """Write a ``.house`` file of which nine tenths are segments, as in real ones."""
    make_samples(folder, "mp3d", 1)
    (path,) = folder.glob("*/house_segmentations/*.house")
    lines = path.read_text().splitlines()
    segment = "E {0} {1} {0} 0.4635 -1.5175 -1.18 0.6525 -1.63 -2.21 0.405 -1.405 -0.15 0.9 0 0 0 0 0\n"
    own = [line for line in lines if line.startswith("E ")]
    count = len(own) + (BIG - path.stat().st_size) // 90
    words = lines[1].split()
    words[7] = str(count)
    with path.open("w") as out:
        out.write("\n".join([lines[0], " ".join(words), *lines[2:]]) + "\n")
        out.writelines(segment.format(k, k % 20) for k in range(len(own), count))
    return "mp3d", path.stem, path


def _house_of_objects(folder: Path) -> tuple[str, str, Path]:
    """Write a ``.house`` file with only objects; no building has so many."""
    family, scene_id, path = _house(folder)
    lines = [line for line in path.read_text().splitlines()[:2000] if not line.startswith("E ")]
    first = next(line for line in lines if line.startswith("O ")).split(" ", 2)[2]
    with path.open("w") as out:
        out.write("\n".join(lines) + "\n")
        out.writelines(f"O {k} {first}\n" for k in range(1000, 1000 + BIG // (len(first) + 9)))
    return family, scene_id, path


def _lines(folder: Path, packed: bool = False) -> tuple[str, str, Path]:
    """Write ProcTHOR houses, one per line; the last one is read."""
    make_samples(folder, "procthor", 20)
    (made,) = folder.glob("houses*")
    data = gzip.decompress(made.read_bytes()) if made.suffix == ".gz" else made.read_bytes()
    made.unlink()
    turns = BIG // len(data) + 1
    path = folder / ("many.jsonl.gz" if packed else "many.jsonl")
    with gzip.open(path, "wb", compresslevel=1) if packed else path.open("wb") as out:
        for _ in range(turns):
            out.write(data)
    return "procthor", f"many-{turns * len(data.splitlines()) - 1}", path


def _metadata(family: str, folder: Path) -> tuple[str, str, Path]:
    """Write controller metadata of many thousand objects, each with all fields of the simulator."""
    make_samples(folder, family, 1)
    path = sorted(folder.glob("FloorPlan*.json"))[0]
    document = json.loads(path.read_text())
    for other in folder.glob("FloorPlan*"):
        other.unlink()
    items = [item | FLAGS for item in document["objects"]]
    written, number = 0, 0
    with path.open("w") as out:
        out.write(f'{{"sceneName": "{document["sceneName"]}", "objects": [')
        while written < BIG:
            for item in items:
                name = f"{item['objectId']}|{number}"
                text = json.dumps(item | {"objectId": name, "about": "x" * 200})
                written += out.write(f"{', ' if number else ''}{text}")
                number += 1
        out.write("]}")
    return family, path.stem, path


def _graph(folder: Path) -> tuple[str, str, Path]:
    """Write a Gibson graph as JSON with 300,000 objects of 300 bytes, more than any building has."""
    make_samples(folder, "gibson", 1)
    (path,) = folder.glob("verified/*.scn")
    document = json.loads(path.read_text())
    text = json.dumps(document["objects"])[1:-1]
    with path.open("w") as out:
        out.write(f'{{"rooms": {json.dumps(document["rooms"])}, "objects": [{text}')
        for number in range(1000, 1000 + BIG // len(text)):
            out.write(", " + text.replace('"id": ', f'"id": {number}'))
        out.write("]}")
    return "gibson", f"verified/{path.stem}", path


def _arrays(folder: Path) -> tuple[str, str, Path]:
    """Write a graph in Gibson's original form, which consists mostly of numbers by face and by voxel."""
    make_samples(folder, "gibson", 2)
    (path,) = folder.glob("verified/*.npz")
    with np.load(path, allow_pickle=True) as archive:  # our own file
        graph = archive["output"].item()
    faces = np.random.default_rng(0).integers(0, 100, (BIG // 8, 1))
    graph["building"]["object_inst_segmentation"] = faces
    np.savez(path, output=np.array(graph, dtype=object))
    for other in folder.glob("verified/*.scn"):
        other.unlink()
    return "gibson", f"verified/{path.stem.removeprefix('3DSceneGraph_')}", path


BIG_FILES: Final[dict[str, Callable[[Path], tuple[str, str, Path]]]] = {
    "mp3d .house": _house,
    "mp3d .house of objects": _house_of_objects,
    "procthor .jsonl": _lines,
    "procthor .jsonl.gz": lambda folder: _lines(folder, packed=True),
    "ithor metadata": lambda folder: _metadata("ithor", folder),
    "robothor metadata": lambda folder: _metadata("robothor", folder),
    "gibson .scn": _graph,
    "gibson .npz": _arrays,
}
"""Writers of large files: family, scene to read, path."""


if __name__ == "__main__":
    main()
