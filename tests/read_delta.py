"""Reads Delta tables by delta-rs into Arrow files; a program of its own.

delta-rs holds Python's lock while it waits for a bucket, and the bucket of the tests is served by a thread of theirs.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pyarrow as pa
import pyarrow.feather

SECONDS = 120


def read_delta(folder: Path, tables: list[tuple[str, int | None]], options: dict[str, str]) -> list[pa.Table]:
    """Rows of each (address, version), with files between in ``folder``."""
    question = json.dumps({"folder": str(folder), "tables": tables, "options": options})
    subprocess.run([sys.executable, __file__, question], check=True, timeout=SECONDS)
    return [pa.feather.read_table(folder / f"{at}.arrow") for at in range(len(tables))]


def _main(folder: str, tables: list[tuple[str, int | None]], options: dict[str, str]) -> None:
    from deltalake import DeltaTable, QueryBuilder

    for at, (address, version) in enumerate(tables):
        table = DeltaTable(address, version=version, storage_options=options)
        rows = pa.table(QueryBuilder().register("t", table).execute("SELECT * FROM t").read_all())
        pa.feather.write_feather(rows, f"{folder}/{at}.arrow", compression="uncompressed")


if __name__ == "__main__":
    _main(**json.loads(sys.argv[1]))
