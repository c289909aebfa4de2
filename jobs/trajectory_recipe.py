"""The units of ``condvln trajectories --from-recipe``, and the comparison of new images with the recipe's hashes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from condvln.formats.image_files import encoders, encoders_of
from condvln.sensors.textures import decoders
from condvln.sources.source import HashFile
from condvln.trajectories.hub import SceneWalks
from condvln.trajectories.recipe import Recipe
from factory.unit import InputFile, Unit
from jobs.trajectory_units import FILMED, Frames, Target, configured, scene_handles, scene_unit
from schemas.canonical import digest
from schemas.errors import ProofError
from schemas.trajectory_tables import TRAJECTORY_TABLES

__all__ = ["Comparison", "encoder_lines", "other_decoders", "recipe_target", "recipe_units", "scene_files"]


def recipe_target(recipe: Recipe, scenes: tuple[str, ...]) -> Target:
    """Return the target of a recipe: the split of the recipe, and the datasets from which the scenes are read.

    scenes : ``FAMILY=FOLDER`` each
    """
    return Target(recipe.folder, recipe.record.split, (), configured(scenes), {}, recipe.record.export_snapshot)


def recipe_units(recipe: Recipe, target: Target, hash_file: HashFile) -> list[Unit]:
    """List the scenes of a recipe as units; a scene that no dataset has becomes a unit that holds its error."""
    scenes = recipe.scenes
    handles = scene_handles(target, {scene for _, scene in scenes}, hash_file)
    inputs = []
    for name in TRAJECTORY_TABLES:
        size, sha256 = hash_file(recipe.folder / f"{name}.parquet")
        inputs.append(InputFile(f"recipe/{name}", size, sha256))
    return [
        scene_unit(
            family,
            scene_id,
            handles.get((family, scene_id)),
            inputs,
            {"episodes": scene.episodes},
            Frames(scene.frames, scene.poses, scene.told, scene.squared / FILMED),
            recipe.record.cameras,
        )
        for (family, scene_id), scene in sorted(scenes.items())
    ]


def scene_files(unit: Unit) -> str:
    """Return a hash over the source files of a scene."""
    own = [file for file in unit.inputs if not file.path.startswith(("manifest/", "recipe/"))]
    return digest([[file.path, file.size, file.sha256] for file in own])


def encoder_lines(recipe: Recipe) -> list[str]:
    """Return a sentence for each kind of image that another encoder, or another version, writes here than wrote the
    recipe's, so that its files have other bytes, and for each kind of texture that another decoder reads here.
    """
    theirs, ours = encoders_of(recipe.record.libraries, recipe.record.encoders), encoders()
    kinds = sorted({name.partition(".")[0] for name in recipe.record.cameras})
    suffixes = {"rgb": "jpg", "depth": "png"}
    lines = [
        f"{theirs.get(suffix, 'An unnamed encoder')} wrote the {suffix} files of the recipe; "
        f"{ours[suffix]} writes them here: bytes may differ"
        for suffix in (suffixes[kind] for kind in reversed(kinds))
        if theirs.get(suffix) != ours[suffix]
    ]
    return lines + other_decoders(recipe.record.decoders, decoders())


def other_decoders(theirs: Mapping[str, str], ours: Mapping[str, str]) -> list[str]:
    """Return a sentence for each kind of texture that another decoder, or another version, reads here than read it when
    the images were made: the colours may differ. Older records name no decoders.
    """
    return [
        f"Textures ({kind}): read by {theirs[kind]} when the images were made, by {ours[kind]} here; colours may differ"
        for kind in sorted(theirs.keys() & ours.keys())
        if theirs[kind] != ours[kind]
    ]


@dataclass
class Comparison:
    """Counts images that are, and are not, those of a recipe.

    scenes : scenes whose source files differ from those that the recipe was made with
    """

    recipe: Recipe
    same: int = 0
    different: int = 0
    first: str = ""
    scenes: list[str] = field(default_factory=list)

    def add(self, scene: SceneWalks) -> None:
        """Compare the images of a scene."""
        wanted = self.recipe.hashes(scene.source, scene.scene_id)
        poses = scene.tables["poses"]
        found = dict(zip(poses["image"].to_pylist(), poses["sha256"].to_pylist(), strict=True))
        for image in sorted(wanted.keys() | found.keys()):
            if wanted.get(image) == found.get(image):
                self.same += 1
            else:
                self.different += 1
                self.first = self.first or image

    def add_files(self, unit: Unit) -> None:
        """Compare the source files of a scene with those that the recipe was made from."""
        if self.recipe.record.scene_files.get(unit.unit_id, "") not in ("", scene_files(unit)):
            self.scenes.append(unit.unit_id)

    def document(self) -> dict[str, Any]:
        """Return the counts for scripts."""
        return {
            "images_of_the_recipe": self.same,
            "images_unlike_the_recipe": self.different,
            "scenes_unlike_the_recipe": sorted(self.scenes),
        }

    def lines(self, libraries: dict[str, str]) -> list[str]:
        """Return the result in words.

        libraries : versions of the libraries here
        """
        lines = [f"{self.same:,} of {self.same + self.different:,} images are those of the recipe, byte for byte"]
        if self.different:
            lines.append(f"The first image that differs: {self.first}")
        if self.scenes:
            shown = ", ".join(sorted(self.scenes)[:5])
            lines.append(f"Files of {len(self.scenes):,} scenes differ from those of the recipe: {shown}")
        theirs = self.recipe.record.libraries
        other = [
            f"{name} {theirs[name]} (here {libraries[name]})"
            for name in sorted(theirs.keys() & libraries)
            if theirs[name] != libraries[name]
        ]
        if other:
            lines.append(f"The recipe was made with {', '.join(other)}")
        return lines + encoder_lines(self.recipe)

    @property
    def exit_code(self) -> int:
        """The exit code of a run: the exit code of a failed proof if an image differs from the recipe, else 0."""
        return ProofError.exit_code if self.different else 0
