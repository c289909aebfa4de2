"""Find the images in a folder of trajectories that must be made again: those that a stopped run left damaged, and those
that another run overwrote.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from factory.commits import Commits
from factory.local_store import LocalStore
from jobs.stages.trajectories import NO_IMAGES, STAMP, stamp_path
from schemas.errors import CondVLNError

__all__ = ["forget_damaged"]


def forget_damaged(store: LocalStore, folder: Path, state: Path) -> None:
    """Remove the commits of images that are missing, truncated or overwritten by another commit, so that the images are
    made again.
    """
    commits = Commits(store)
    for stage, key in [*commits.committed()]:
        if stage != "frames":
            continue
        found = commits.find(stage, key)
        if found is None:
            continue
        commit = found.commit
        try:
            stamp = commits.file(commit, STAMP)
            if stamp == NO_IMAGES:
                continue
            sound = stamp_path(state, commit.unit_id).read_bytes() == stamp
            poses = commits.table(stage, key, "poses")
        except (CondVLNError, OSError):
            sound = False
        if not (sound and _complete(folder, poses.select(["image", "bytes"]).to_pylist())):
            commits.discard(stage, key)


def _complete(folder: Path, images: Sequence[Mapping[str, Any]]) -> bool:
    sizes: dict[Path, dict[str, int]] = {}
    for image in images:
        path = folder / image["image"]
        if path.parent not in sizes:
            with suppress(OSError):
                sizes[path.parent] = {entry.name: entry.stat().st_size for entry in path.parent.iterdir()}
        if sizes.get(path.parent, {}).get(path.name) != image["bytes"]:
            return False
    return True
