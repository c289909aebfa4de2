"""Read the files of a folder of trajectories for its proof. Whatever is damaged is one error that names the file."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import orjson
import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import ValidationError

from condvln.formats.image_files import encoders_of
from condvln.formats.parquet_rows import refuse_parquet_bombs
from condvln.formats.regular_file import read_regular
from schemas.config import CameraConfig, TrajectoryConfig
from schemas.errors import FormatError, MissingFileError
from schemas.first_fault import first_fault
from schemas.trajectory_tables import TRAJECTORY_TABLES

__all__ = ["MOST_PNG_LEVEL", "read_annotations", "read_record", "read_table", "walks_with_poses"]

Row = Mapping[str, Any]

_REMEDY: Final = "Run condvln trajectories again with this folder; it makes damaged images again."
MOST_PNG_LEVEL: Final = 3
"""Highest compression level of the encoder here. Records of Pillow's images may have a higher one, which leaves the
pixels as they are.
"""
_PILLOWS_PNG_LEVEL: Final = 9
"""Highest compression level of Pillow."""
_CAMERA_NAME: Final = re.compile(r"(rgb|depth)(\.[A-Za-z0-9_.-]{1,60})?")


def read_record(folder: Path) -> dict[str, Any]:
    path = folder / "trajectories.json"
    try:
        found = orjson.loads(read_regular(path))
        return {
            "cameras": {name: _camera(name, camera) for name, camera in dict(found["cameras"]).items()},
            "config": _config(found["config"]),
            "encoders": encoders_of(_texts(found, "libraries"), _texts(found, "encoders")),
            "decoders": _texts(found, "decoders"),
            "layouts": list(found["layouts"]),
            "split": str(found["split"]),
            "images_written": bool(found.get("images_written", True)),
        }
    except FileNotFoundError:
        raise MissingFileError("the folder holds no trajectories", where=folder, remedy=_REMEDY) from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FormatError(f"not a record of trajectories ({first_fault(error)})", where=path, remedy=_REMEDY) from None


def _camera(name: str, camera: Any) -> dict[str, Any]:
    """Return a camera of a record with all its values.

    Raises
    ------
    ValueError : its name or a value of it can't be that of a camera
    """
    if not _CAMERA_NAME.fullmatch(name):
        raise ValueError(f"cameras: {name!r} is not a name of a camera")
    try:
        return CameraConfig.model_validate(camera).model_dump(mode="json")
    except ValidationError as error:
        raise ValueError(f"cameras.{name}: {first_fault(error)}") from None


def _config(config: Any) -> dict[str, Any]:
    """Return the configuration of a record with all its values. ``png_level`` may be one of Pillow's, which go further
    than those of the encoder here.

    Raises
    ------
    ValueError, TypeError : a value of it is not allowed
    """
    level = dict(config).get("png_level")
    high = type(level) is int and MOST_PNG_LEVEL < level <= _PILLOWS_PNG_LEVEL
    try:
        valid = TrajectoryConfig.model_validate(config | {"png_level": MOST_PNG_LEVEL} if high else config)
    except ValidationError as error:
        raise ValueError(f"config.{first_fault(error)}") from None
    return valid.model_dump(mode="json") | ({"png_level": level} if high else {})


def _texts(record: Row, key: str) -> dict[str, str]:
    """Return a mapping of texts of a record; it may be absent.

    Raises
    ------
    TypeError : it is something else
    """
    found = record.get(key, {})
    if not isinstance(found, dict) or not all(isinstance(text, str) for text in found.values()):
        raise TypeError(f"{key}: not a mapping of names to texts")
    return found


def read_annotations(folder: Path) -> list[dict[str, Any]]:
    path = folder / "annotations.json"
    try:
        found = orjson.loads(read_regular(path))
        for entry in found:
            if {"id", "video", "instructions", "actions", "kind"} - entry.keys():
                raise TypeError("an entry lacks a key")
            if not isinstance(entry["actions"], list):
                raise TypeError("the actions of an entry are not a list")
    except FileNotFoundError:
        raise MissingFileError("annotations.json is missing", where=folder, remedy=_REMEDY) from None
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise FormatError(f"not a list of walks ({error})", where=path, remedy=_REMEDY) from None
    return list(found)


def read_table(folder: Path, name: str) -> pa.Table:
    path = folder / f"{name}.parquet"
    try:
        refuse_parquet_bombs(path)
        found = pq.read_table(path)
        _refuse_other_columns(found.schema, name)
        _refuse_missing_values(found, name)
        return found
    except FileNotFoundError:
        raise MissingFileError(f"{name}.parquet is missing", where=folder, remedy=_REMEDY) from None
    except (pa.ArrowException, OSError, ValueError) as error:
        raise FormatError(f"not a table of walks ({error})", where=path, remedy=_REMEDY) from None


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
    try:
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
    except FileNotFoundError:
        raise MissingFileError("poses.parquet is missing", where=path.parent, remedy=_REMEDY) from None
    except (pa.ArrowException, OSError, ValueError) as error:
        raise FormatError(f"not a table of walks ({error})", where=path, remedy=_REMEDY) from None
