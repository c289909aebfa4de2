"""Terms of the datasets whose scenes are seen in a folder of trajectories, and who may have its images."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from condvln.sources.family import FAMILIES
from schemas.errors import UsageError

__all__ = ["licences", "read_me", "refuse_unlicensed"]


def licences(families: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return the name, terms and credit of each family, and whether its images may be passed on, by family."""
    return {
        name: {
            "name": FAMILIES[name].name,
            "terms": FAMILIES[name].terms,
            "credit": FAMILIES[name].credit,
            "images_may_be_shared": not FAMILIES[name].licensed,
        }
        for name in sorted(set(families) & FAMILIES.keys())
    }


def refuse_unlicensed(families: Iterable[str]) -> None:
    """Refuse to make images of scenes if the terms of their family do not allow images to be passed on.

    Raises
    ------
    UsageError : there is such a family
    """
    closed = [FAMILIES[name].name for name in sorted(set(families) & FAMILIES.keys()) if FAMILIES[name].licensed]
    if closed:
        raise UsageError(
            f"the terms of {' and '.join(closed)} forbid to pass on images of the scenes",
            place="--licensed",
            remedy="Add --licensed if you have accepted these terms and keep the images to yourself; or add "
            "--recipe-only to write what may be shared: actions, poses, cameras and hashes, without images.",
        )


def read_me(split: str, terms: Mapping[str, Mapping[str, Any]], files: Sequence[str], *, images: bool) -> str:
    """Return the text of the folder's ``README.md``.

    terms : by family, as `licences` returns them
    files : files of the recipe
    images : whether the folder has images
    """
    closed = [row["name"] for row in terms.values() if not row["images_may_be_shared"]]
    lines = [
        "# Trajectories",
        "",
        f"Walks of the split `{split}`, made by `condvln trajectories`.",
        "",
        "| dataset | terms | images may be passed on | credit |",
        "|---|---|---|---|",
    ]
    for row in terms.values():
        shared = "yes, under these terms" if row["images_may_be_shared"] else "no"
        lines.append(f"| {row['name']} | {row['terms']} | {shared} | {row['credit']} |")
    lines.append("")
    recipe = ", ".join(f"`{name}`" for name in files)
    if not images:
        lines.append("This folder is a recipe: it has no images.")
    elif closed:
        lines.append(
            f"**Do not pass on the images of {' and '.join(closed)}**, nor files made from them. What may be shared is "
            f"the recipe: {recipe}, also in `recipe/`."
        )
    else:
        lines.append(f"The recipe is in `recipe/`: {recipe}.")
    lines += [
        "",
        "The recipe gives the same images again on a computer that has the datasets:",
        "",
        "```",
        "condvln trajectories --from-recipe DIR --scenes FAMILY=DATASET --out OUT",
        "```",
        "",
    ]
    return "\n".join(lines)
