"""Numbers that decide stand in ``schemas.config`` alone, and no two classes are copies of each other; read from the
syntax trees, so that nothing has to be imported."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

from condvln.instructions.likeness import SCANS
from condvln.samples import FAMILIES as WRITERS
from condvln.scene.containment import SCANNED
from condvln.sources.downloads import downloads
from condvln.sources.family import FAMILIES
from condvln.sources.registry import READERS
from condvln.verify.containment import FROM_SCANS
from jobs.costs import COEFFICIENTS
from schemas.config import Family

PACKAGES = ("schemas", "condvln", "factory", "jobs")
DECIDING = ("relations", "instructions", "episodes", "verify")
"""Folders of ``condvln`` that decide what an episode is, or check it."""

TECHNICAL = {
    # Arithmetic: slack for rounding, and bounds of what is equal.
    "relations/solids.py": {"AXIS_TOLERANCE", "_WINDING_CHUNK", "ASSETS_KEPT"},
    "relations/box_distances.py": {"PARALLEL", "PAIRS_AT_ONCE"},
    "relations/surface.py": {"TOUCHING"},
    "relations/triangle_trees.py": {"SAME", "DEEPEST"},
    "relations/metrics.py": {"MILLIMETRES_PER_METRE"},
    "relations/table.py": {"_NO_METRIC"},
    "relations/compass.py": {"SECTOR_DEGREES", "COINCIDENT"},
    "relations/bearing.py": {"SLACK"},
    "episodes/footprint.py": {"ROUNDING", "_SIDES"},
    "episodes/observability.py": {"NEEDS_AT_ONCE"},
    "verify/containment.py": {"_MM"},
    "verify/surfaces.py": {"KEPT_TRIANGLES", "ORTHOGONAL"},
    "verify/lookouts.py": {"EVEN"},
    "verify/episode_record.py": {"HEADING"},
    "verify/heading.py": {"UNIT"},
    # The highest level of the PNG encoder: folders of earlier encoders name higher ones.
    "verify/trajectories.py": {"_ANGLE"},
    "verify/trajectory_files.py": {"MOST_PNG_LEVEL", "_PILLOWS_PNG_LEVEL"},
    "verify/ground_truth.py": {"ROUNDED", "SLACK"},
    "verify/footprints.py": {"TOUCHING"},
    "verify/placement.py": {"MILLIMETRE"},
    "verify/scene_leaves.py": {"ROUNDING"},
    "episodes/placing.py": {"COMPASS_STEP"},
    # The verifier's own measurement: how many samples, how sure, how many at once.
    "verify/sight.py": {"OWN_POINTS", "ODDS", "EYES_AT_ONCE", "RAYS_AT_ONCE", "TURNS", "LINES_KEPT", "_R2"},
    "verify/visibility.py": {"POINTS", "FEW", "SEEN_SHARE"},
    "verify/files.py": {"_BLOCK"},
    "verify/completeness.py": {"_BLOCK"},
    "verify/judgement.py": {"TRUE", "FALSE", "UNDECIDED"},
    "verify/slices.py": {"SAME_SECTION", "TOUCHING"},
    "verify/clause_reader.py": {"MAX_CONDITIONS", "_CASES", "_ALWAYS"},
    "verify/part_forms.py": {"MOST_RESULTS"},
    "verify/text_parts.py": {"LONGEST_PART", "MOST_APART", "MOST_PARTS"},
    "verify/text_table.py": {"MOST_PARTS"},
    # Order of work and memory; the result is the same whatever they are.
    "instructions/priors.py": {"LAYOUTS_KEPT", "MERGE_ROWS"},
    "instructions/stop_sampler.py": {"ANSWERS_KEPT"},
    "episodes/view.py": {"FIRST_LOOKS", "LOOK_TURNS", "LOOKS_AT_ONCE"},
    "episodes/goals.py": {"TRIED_AT_ONCE"},
    "episodes/visibility.py": {"FIRST_PLACES", "CLOSE_SAMPLES"},
    # Formats of ids.
    "instructions/programs.py": {"ID_LENGTH"},
    "episodes/identity.py": {"HASH_DIGITS", "ID_BITS"},
    # How hard a search tries; what it finds is checked by rules that are keys.
    "episodes/facing.py": {"HEADINGS"},
    "episodes/starts.py": {"CORNERS", "WAYS"},
    "instructions/sampling.py": {"TRIES_PER_CANDIDATE", "VAIN_TRIES"},
    "instructions/referents.py": {"ALTERNATIVES", "ROOM_NAMES"},
    "instructions/balance.py": {"BALANCING_ROUNDS", "LEAST_WEIGHT"},
    "instructions/informative.py": {"EXACT", "PSEUDOCOUNT"},
    "instructions/expected_draws.py": {
        "EVENING_ROUNDS",
        "FACTOR_STEPS",
        "FULL_MASS",
        "LEAST_SHARE",
        "MOST_A_ROUND",
        "MOST_OCTAVES",
    },
    "instructions/stagings.py": {"MANY_STAGINGS"},
    "instructions/array_file.py": {"IN_MEMORY"},
    "instructions/tilts.py": {"COIN_PART", "SHARED_WORD_WEIGHT", "SCENES_ADDED"},
    # Voices of the text: wordings that mean the same, and where a sentence is split.
    "instructions/renderer.py": {
        "CHECK_SHARE",
        "COMPOUND_SHARE",
        "HAS_SHARE",
        "LOOK_AT_SHARE",
        "LOOK_SHARE",
        "RESTATE_SHARE",
    },
    "instructions/language.py": {"MOST_STATED"},
    "instructions/reach.py": {"MOST_STEPS"},
    "verify/phrases.py": {"FARTHEST"},
    "verify/word_reader.py": {"LONGEST_KEPT", "MOST_KEPT", "MOST_MEANINGS"},
    "verify/phrasebook.py": {"_FIRST_LETTER"},
    "instructions/sentences.py": {"LONGEST_SENTENCE"},
    # Codes of compiled kernels: which rule refused, and columns of arrays. Two are bounds of a search.
    "episodes/kernels/starts.py": {
        "ACCEPTED",
        "DETOUR",
        "FITS",
        "FULL",
        "FURNITURE",
        "LENGTH",
        "NOTHING_FITS",
        "NO_ROOM",
        "OTHER_LEAF",
        "OUT_OF_RANGE",
        "PER_METRE",
        "TOO_FAR",
        "UNKNOWN",
        "UNREACHABLE",
    },
    "instructions/kernels/conditions.py": {
        "ANCHOR",
        "CIRCULAR",
        "CLAIM",
        "GIVEN_AWAY",
        "IMPLIED",
        "LABEL",
        "NAMES_STOP",
        "NOTHING",
        "ONE_LABEL",
        "OTHER_ANCHOR",
        "PRESENCE",
        "ROOM",
        "ROOM_ANCHOR",
        "TAUTOLOGY",
        "TWO_THINGS",
        "UNKNOWN",
    },
    "instructions/kernels/candidates.py": {
        "SHAPES_LEFT",
        "FAILED",
        "FAILED_BEFORE",
        "LEFT",
        "LEFT_BEFORE",
        "FOUND",
        "SEEN",
        "GOLDS",
        "GOLD",
        "COMPOSITION",
    },
    "instructions/kernels/programs.py": {
        "COMPOSITION_MISSED",
        "DUPLICATE",
        "FITS",
        "MOST_ANCHORS",
        "NO_CONDITION",
        "TWO_THINGS",
    },
    "instructions/kernels/stops.py": {
        "LABEL_OVER_CAP",
        "MOST_MOVES",
        "NONE",
        "NO_TARGETS",
        "NO_WAYPOINT",
        "ONE_FIRST_STOP",
        "REJECTIONS",
        "SEARCHED",
    },
    # Where drawings of episodes put their marks and labels.
    "episodes/picture.py": {"HIGH", "LOW", "MARK", "TEXT_SIZES"},
    "episodes/picture_labels.py": {"DIRECTIONS", "GAP", "LED", "NEARBY", "RINGS", "STEP"},
    # R2R's own rules on viewpoint graphs, which are not those of a navmesh.
    "episodes/graph_placing.py": {"REACH", "FARTHEST", "STOREY", "BORDER", "UNEVEN"},
}
"""Numbers that stand where they are used, by file, with the reason why none of them is a part of the configuration."""


def trees(root: Path, *folders: str) -> Iterator[tuple[str, ast.Module]]:
    for folder in folders:
        for path in sorted((root / folder).rglob("*.py")):
            yield path.relative_to(root).as_posix(), ast.parse(path.read_text(encoding="utf-8"))


def is_number(node: ast.expr) -> bool:
    """Whether an expression is made of numbers alone; an index of a negative number counts too."""
    match node:
        case ast.Constant(value=value):
            return isinstance(value, int | float) and not isinstance(value, bool)
        case ast.UnaryOp(operand=inner):
            return is_number(inner)
        case ast.BinOp(left=left, right=right):
            return is_number(left) or is_number(right)
        case ast.Tuple(elts=parts):
            return bool(parts) and all(map(is_number, parts))
    return False


def numbers_of(tree: ast.Module) -> Iterator[str]:
    """Names of numeric constants of a module and of its classes. Fields of dataclasses are lower case."""
    bodies = [tree.body, *(node.body for node in ast.walk(tree) if isinstance(node, ast.ClassDef))]
    for statement in (statement for body in bodies for statement in body):
        match statement:
            case ast.AnnAssign(target=ast.Name(id=name), value=value) if value is not None:
                named = [(name, value)]
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                named = [(name, value)]
            case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Tuple(elts=values)):
                named = [(n.id, v) for n, v in zip(names, values, strict=True) if isinstance(n, ast.Name)]
            case _:
                continue
        yield from (name for name, value in named if name.isupper() and is_number(value))


def test_numbers_that_decide_stand_in_the_configuration_alone(repository: Path) -> None:
    found = {
        path.removeprefix("condvln/"): names
        for path, tree in trees(repository, *(f"condvln/{folder}" for folder in DECIDING))
        if (names := set(numbers_of(tree)))
    }
    assert found == TECHNICAL, "make it a key, or name it in schemas/config/constants.py; or say here why it is neither"


def test_the_configuration_s_numbers_have_one_name(repository: Path) -> None:
    names: defaultdict[str, list[str]] = defaultdict(list)
    for path, tree in trees(repository, "schemas/config"):
        for name in numbers_of(tree):
            names[name].append(path)
    assert len(names) > 20
    copies = [
        (path, name)
        for path, tree in trees(repository, *PACKAGES)
        if not path.startswith("schemas/config/")
        for name in numbers_of(tree)
        if name in names
    ]
    assert copies == []
    assert [name for name, places in names.items() if len(places) > 1] == []


def fields_of(node: ast.ClassDef) -> dict[str, str]:
    return {
        item.target.id: ast.unparse(item.annotation)
        for item in node.body
        if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name)
    }


WIRE = [
    {"schemas/scene.py: RoomRecord", "condvln/scene/scene.py: Room"},
    {"schemas/scene.py: NavmeshChoice", "condvln/scene/scene.py: NavmeshFile"},
]
"""Records of a file, and what they are in memory: arrays in place of lists, and no validation in loops."""


def test_no_two_classes_have_the_same_fields(repository: Path) -> None:
    """Of four fields and more: two small classes may well have equal names."""
    classes: defaultdict[frozenset[str], list[str]] = defaultdict(list)
    for path, tree in trees(repository, *PACKAGES):
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef) and len(fields := fields_of(node)) >= 4:
                classes[frozenset(fields)].append(f"{path}: {node.name}")
    assert len(classes) > 100
    assert [set(names) for names in classes.values() if len(names) > 1 and set(names) not in WIRE] == []


def test_every_list_of_families_is_the_same() -> None:
    names = set(get_args(Family))
    assert names == set(FAMILIES) == set(READERS) == set(WRITERS)
    assert all(downloads(name) for name in names)
    assert {FAMILIES[name].costs_like or name for name in names} == set(COEFFICIENTS)


def test_the_lists_of_scans_agree() -> None:
    """Scans of real buildings are licensed and not composed; three places treat them otherwise than designed homes."""
    scans = {name for name, family in FAMILIES.items() if family.licensed}
    assert scans == set(SCANNED) == set(SCANS) == set(FROM_SCANS)
    assert not any(FAMILIES[name].composed for name in scans)
