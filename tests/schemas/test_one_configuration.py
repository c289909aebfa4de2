"""Numbers of ``schemas.config`` have one name and one place, and no two classes are copies of each other; read from the
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
from condvln.sources.family import FAMILIES, downloads
from condvln.sources.registry import READERS
from condvln.verify.containment import FROM_SCANS
from jobs.costs import COEFFICIENTS
from schemas.config import Family

PACKAGES = ("schemas", "condvln", "factory", "jobs")


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
    """Fields as dataclasses and pydantic count them: a ClassVar is none."""
    found = {
        item.target.id: ast.unparse(item.annotation)
        for item in node.body
        if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name)
    }
    return {name: kind for name, kind in found.items() if not kind.startswith("ClassVar")}


def test_no_two_classes_have_the_same_fields(repository: Path) -> None:
    """Of four fields and more: two small classes may well have equal names."""
    classes: defaultdict[frozenset[str], list[str]] = defaultdict(list)
    for path, tree in trees(repository, *PACKAGES):
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef) and len(fields := fields_of(node)) >= 4:
                classes[frozenset(fields)].append(f"{path}: {node.name}")
    assert len(classes) > 100
    assert [set(names) for names in classes.values() if len(names) > 1] == []


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
