"""Read the files of a folder of trajectories for its proof. Whatever is damaged is one error that names the file."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Final

import orjson
import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import BaseModel, Field

from condvln.formats.parquet_rows import refuse_parquet_bombs
from condvln.formats.regular_file import read_regular
from schemas.base import first_fault
from schemas.config import CameraConfig, TrajectoryConfig
from schemas.errors import FormatError, MissingFileError
from schemas.tables import TRAJECTORY_TABLES

__all__ = ["read_annotations", "read_record", "read_table", "walks_with_poses"]

_REMEDY: Final = "Run condvln trajectories again with this folder; it makes damaged images again."


class _Record(BaseModel):
    """What the proof needs of ``trajectories.json``.

    encoders, decoders : what wrote the images and read the textures, by their kinds
    """

    split: str
    layouts: tuple[str, ...]
    cameras: dict[Annotated[str, Field(pattern=r"^(rgb|depth)(\.[A-Za-z0-9_.-]{1,60})?$")], CameraConfig]
    config: TrajectoryConfig
    encoders: dict[str, str]
    decoders: dict[str, str]
    images_written: bool = True


def read_record(folder: Path) -> dict[str, Any]:
    """Return the content of ``trajectories.json`` with all values of its cameras and of its configuration.

    Raises
    ------
    MissingFileError, FormatError : there is none, or a value of it can't be
    """
    path = folder / "trajectories.json"
    with _reading(path, "a record of trajectories", "the folder holds no trajectories"):
        return _Record.model_validate(orjson.loads(read_regular(path))).model_dump(mode="json")


@contextmanager
def _reading(path: Path, wanted: str, missing: str = "") -> Iterator[None]:
    """Raise what goes wrong with a file as MissingFileError or FormatError: it is missing, or not what is `wanted`."""
    try:
        yield
    except FileNotFoundError:
        missing = missing or f"{path.name} is missing"
        raise MissingFileError(missing, where=path.parent, remedy=_REMEDY) from None
    except (pa.ArrowException, OSError, ValueError, TypeError, AttributeError) as error:
        raise FormatError(f"not {wanted} ({first_fault(error)})", where=path, remedy=_REMEDY) from None


def read_annotations(folder: Path) -> list[dict[str, Any]]:
    path = folder / "annotations.json"
    with _reading(path, "a list of walks"):
        found = orjson.loads(read_regular(path))
        for entry in found:
            if {"id", "video", "instructions", "actions", "kind"} - entry.keys():
                raise TypeError("an entry lacks a key")
            if not isinstance(entry["actions"], list):
                raise TypeError("the actions of an entry are not a list")
        return list(found)


def read_table(folder: Path, name: str) -> pa.Table:
    path = folder / f"{name}.parquet"
    with _reading(path, "a table of walks"):
        refuse_parquet_bombs(path)
        found = pq.read_table(path)
        _refuse_other_columns(found.schema, name)
        _refuse_missing_values(found, name)
        return found


def _refuse_other_columns(found: pa.Schema, name: str) -> None:
    """Raise ValueError if a column of a table is missing, or of another type."""
    for wanted in TRAJECTORY_TABLES[name]:
        if wanted.name not in found.names:
            raise ValueError(f"the column {wanted.name} is missing")
        if found.field(wanted.name).type != wanted.type:
            raise ValueError(f"the column {wanted.name} is {found.field(wanted.name).type}, not {wanted.type}")


def _refuse_missing_values(table: pa.Table, name: str) -> None:
    """Raise ValueError if a value of a table is damaged, or one is missing that each row must have."""
    table.validate(full=True)
    for field in TRAJECTORY_TABLES[name]:
        if not field.nullable and table[field.name].null_count:
            raise ValueError(f"a value of the column {field.name} is missing")


def walks_with_poses(path: Path) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """Yield each walk with its poses. Only one row group, which is one scene, is in memory at a time."""
    with _reading(path, "a table of walks"):
        refuse_parquet_bombs(path)
        with pq.ParquetFile(path) as file:
            _refuse_other_columns(file.schema_arrow, "poses")
            for group in range(file.num_row_groups):
                rows: defaultdict[str, list[dict[str, Any]]] = defaultdict(list)
                table = file.read_row_group(group)
                _refuse_missing_values(table, "poses")
                for row in table.to_pylist():
                    rows[row["trajectory"]].append(row)
                yield from rows.items()
