"""Episodes verified per second and core, and the time of each part.

``python -m benchmarks verify`` makes an export of sample apartments and proves it. With ``CONDVLN_REAL_EXPORT`` and
``CONDVLN_REAL_ROOT`` (an export of ReplicaCAD and the dataset's folder) it proves that one. Times are of the processor.
What is seen from where takes rays, and stands by itself beside the navmesh work.
"""

from __future__ import annotations

import io
import os
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from rich.console import Console

from condvln.samples import make_samples
from condvln.scene import Scene
from condvln.sources.registry import open_source
from condvln.sources.scene_source import Source
from condvln.verify import Surfaces, VerifierRules, proof, prove_export
from condvln.verify.files import ExportFiles
from condvln.verify.proof import SceneReader
from condvln.verify.surfaces import Shapes
from jobs.generate import run_generate
from schemas.config import Config, InstructionsConfig, SourceConfig
from schemas.program import CATEGORIES

__all__ = ["main"]

SCENES: Final = 6
PER_CATEGORY: Final = 20
ROUNDS: Final = 5
"""Number of verifications of the whole export."""
TARGET: Final = 1000
"""Target: episodes per second and core, without navmesh work."""

NAVMESH: Final[tuple[tuple[Any, str], ...]] = (
    (proof, "find_navmesh"),
    (proof, "Obstacles"),
    (proof, "check_placement"),
    (proof, "check_truths"),
)
"""Functions that query the navmesh: paths and distances, loading, the floor below furniture, and walks with discrete
steps."""
SIGHT: Final[tuple[tuple[Any, str], ...]] = ((proof, "sight_of"), (proof, "check_observability"))
"""Functions that compute visibility: a scene's surfaces, occluders, floors, and the ray casts themselves."""
LOOKING: Final[tuple[tuple[Any, str], ...]] = ((proof, "check_looking"),)
"""Looking paths: walks on the navmesh, and what their frames show."""
ASIDE: Final = ("navmesh", "sight", "looking")
"""Work that has its own line in the output."""


def main() -> None:
    """Print the rates."""
    export, root = os.environ.get("CONDVLN_REAL_EXPORT"), os.environ.get("CONDVLN_REAL_ROOT")
    if export and root:
        _measure(Path(export), Path(root))
        return
    with TemporaryDirectory() as folder:
        _measure(*_made(Path(folder)))


def _made(folder: Path) -> tuple[Path, Path]:
    make_samples(folder / "scenes", family="replicacad", scenes=SCENES, seed=0)
    config = Config(
        name="benchmark",
        store=folder / "store",
        export=folder / "export",
        sources=(SourceConfig(family="replicacad", root=folder / "scenes"),),
        instructions=InstructionsConfig(per_category=dict.fromkeys(CATEGORIES, PER_CATEGORY)),
    )
    run_generate(config, inline=True, console=Console(file=io.StringIO()))
    return folder / "export", folder / "scenes"


def _measure(export: Path, root: Path) -> None:
    source = open_source("replicacad", root)
    spent: Counter[str] = Counter()
    for _ in prove_export(export, VerifierRules(), _reader(source, source.read)):
        pass  # kernels are compiled and files cached
    for kind, asking in zip(ASIDE, (NAVMESH, SIGHT, LOOKING), strict=True):
        for owner, name in asking:
            setattr(owner, name, _timed(getattr(owner, name), kind, spent))
    setattr(Shapes, "of", _timed(Shapes.of, "meshes", spent))  # noqa: B010
    read = _reader(source, _timed(source.read, "scenes read", spent))
    count = sum(len(run.rows) for run in ExportFiles(export).runs())
    rounds = [_round(export, read, spent) for _ in range(ROUNDS)]
    # Scene by scene the quickest round counts: other work on the machine only ever slows one down.
    quickest = [min(found, key=lambda part: part.own) for found in zip(*rounds, strict=True)]
    proven, total = sum(part.proven for part in quickest), sum(part.seconds for part in quickest)
    parts: Counter[str] = sum((part.spent for part in quickest), Counter())
    rest = total - sum(parts[kind] for kind in ASIDE)
    print(f"{proven} of {count} episodes proven in {total:.2f} s of one core: {count / total:,.0f} a second")
    known = sum(parts.values())
    for name, seconds in [*parts.items(), ("everything else", total - known)]:
        print(f"  {name:<16} {1e6 * seconds / count:8.0f} µs an episode")
    print(f"apart from navmesh work and sight: {count / rest:,.0f} episodes a second (target {TARGET:,})")
    print(f"apart from navmesh work and looking paths: {count / (rest + parts['sight']):,.0f} episodes a second")
    print(f"sight by itself: {count / parts['sight']:,.0f} episodes a second")
    print(f"apart from reading scenes too: {count / (total - known):,.0f} episodes a second")


def _reader(source: Source, read: Callable[[str], Scene]) -> SceneReader:
    def both(_: str, scene_id: str) -> tuple[Scene, Surfaces]:
        scene = read(scene_id)
        return scene, partial(source.geometry, scene)

    return both


@dataclass
class _Part:
    """Time that the verification of one scene took, by part."""

    proven: int
    seconds: float
    spent: Counter[str]

    @property
    def own(self) -> float:
        """Return the seconds without the work that has its own lines."""
        return self.seconds - sum(self.spent[kind] for kind in ASIDE)


def _round(export: Path, read: SceneReader, spent: Counter[str]) -> list[_Part]:
    """Verify the whole export once; return the parts by scene."""
    parts: list[_Part] = []
    spent.clear()
    began, before, scene = time.process_time(), Counter[str](), ""
    for certificate in prove_export(export, VerifierRules(), read):
        if certificate.scene_id != scene:
            # The certificates of a scene come together, when all of them are made.
            now = time.process_time()
            parts.append(_Part(0, now - began, Counter({k: spent[k] - before[k] for k in spent})))
            began, before, scene = now, Counter(spent), certificate.scene_id
        parts[-1].proven += certificate.proven
    return parts


def _timed(function: Callable[..., Any], name: str, spent: Counter[str]) -> Callable[..., Any]:
    def timed(*args: Any, **kwargs: Any) -> Any:
        began = time.process_time()
        try:
            return function(*args, **kwargs)
        finally:
            spent[name] += time.process_time() - began  # type: ignore[assignment]

    return timed
