"""Read the configuration: YAML file, then CONDVLN_ variables, then ``--set``. Every error names its key."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from pydantic import ValidationError

from factory.store import open_store
from jobs.settings import config_error, put, read_yaml, yaml_value
from schemas.config import Config
from schemas.errors import ConfigError, UsageError

__all__ = ["ENVIRONMENT_PREFIX", "load_config"]

ENVIRONMENT_PREFIX: Final = "CONDVLN_"
"""Prefix of variables: ``CONDVLN_RAY__WORKERS=2`` sets ``ray.workers``. Two underscores separate the keys."""


def load_config(
    path: Path, overrides: Sequence[str] = (), environment: Mapping[str, str] | None = None, *, check_roots: bool = True
) -> Config:
    """Read, override and validate one configuration.

    Parameters
    ----------
    path : the YAML file; relative folders in it count from its own folder
    overrides : ``a.b=value`` strings, the last word; ``family=folder`` sets the roots of a family's sources
    environment : variables to look for ``CONDVLN_…`` in; the process's own by default
    check_roots : whether a missing source folder is an error

    Raises ConfigError naming the key and what is allowed.
    """
    if not path.is_file():
        raise ConfigError("no such configuration file", where=path, remedy="Give the path of a YAML file.")
    data = read_yaml(path, "configs/replicacad.yaml")
    for name, value in sorted((os.environ if environment is None else environment).items()):
        keys = name.removeprefix(ENVIRONMENT_PREFIX).lower().split("__")
        # Other CONDVLN_ variables exist (paths of tests and caches); only keys of the configuration count.
        if name.startswith(ENVIRONMENT_PREFIX) and keys[0] in Config.model_fields:
            put(data, keys, yaml_value(value, name), origin=name)
    for text in overrides:
        key, equals, value = text.partition("=")
        if not equals or not key:
            raise ConfigError(f"--set {text!r} is not of the form a.b=value", remedy="Example: --set ray.workers=2")
        sources = data.get("sources")
        sources = sources if isinstance(sources, list) else []
        named = [k for k, one in enumerate(sources) if isinstance(one, dict) and one.get("family") == key]
        for k in named:
            put(data, ["sources", str(k), "root"], str(Path(value).resolve()), origin=f"--data {text}")
        if not named:
            put(data, key.split("."), yaml_value(value, f"--set {key}"), origin=f"--set {text}")
    try:
        config = Config.model_validate(data)
    except ValidationError as error:
        raise config_error(error, path) from None
    return _resolve(config, path.resolve().parent, path, check_roots)


def _store(address: Path | str, base: Path, path: Path) -> Path | str:
    """Resolve the address of a store. A folder is relative to the configuration file's own folder; an object store's
    address is checked but not contacted.
    """
    if "://" not in str(address):
        return (base / address).resolve()
    try:
        open_store(str(address))
    except UsageError as error:
        raise ConfigError(error.what, where=path, place="store", remedy=error.remedy) from None
    return str(address)


def _resolve(config: Config, base: Path, path: Path, check_roots: bool) -> Config:
    sources = []
    export = None if config.export is None else (base / config.export).resolve()
    for k, source in enumerate(config.sources):
        root = (base / source.root).resolve()
        if not root.exists() and export is not None:  # where --data said that it lies when the export was made
            from jobs.export_origin import data_of  # loads the pipeline

            noted = {text for text in data_of(export, None) if text.startswith(f"{source.family}=")}
            if len(noted) == 1:
                missing, root = root, Path(noted.pop().partition("=")[2])
                said = (
                    f"{source.family}: {missing} does not exist; scenes are read in {root}, as when the export was made"
                )
                print(said, file=sys.stderr)
        if check_roots and not root.is_dir():
            raise ConfigError(
                f"this is a file, not a folder: {root}" if root.exists() else f"no such folder: {root}",
                where=path,
                place=f"sources.{k}.root",
                remedy=f"Point it at your copy of {source.family}, or name it with --data {source.family}=DIR.",
            )
        if check_roots and source.navmesh is not None and not (root / source.navmesh).is_dir():
            raise ConfigError(
                f"no such folder: {root / source.navmesh}",
                where=path,
                place=f"sources.{k}.navmesh",
                remedy="Give the path of a folder of navmeshes, relative to the source's root.",
            )
        beside = {"root": root}
        for key in ("regions", "connectivity", "houses"):
            if (named := getattr(source, key)) is None:
                continue
            beside[key] = (base / named).resolve()
            if check_roots and not (beside[key].is_dir() or (key == "regions" and beside[key].exists())):
                what = "file or folder" if key == "regions" else "folder"
                raise ConfigError(f"no such {what}: {beside[key]}", where=path, place=f"sources.{k}.{key}")
        sources.append(source.model_copy(update=beside))
    store = _store(config.store, base, path)
    _apart(store, export, [source.root for source in sources], path)
    return config.model_copy(update={"sources": tuple(sources), "store": store, "export": export})


def _apart(store: Path | str, export: Path | None, roots: Sequence[Path], path: Path) -> None:
    """Require that the store and the export lie outside of the datasets' folders. Otherwise every rebuild would mistake
    the files that a run writes for changes of a dataset.
    """
    written = [(key, folder) for key, folder in (("store", store), ("export", export)) if isinstance(folder, Path)]
    for k, (key, folder) in enumerate(written):
        for other, taken in (*((f"sources.{j}.root", root) for j, root in enumerate(roots)), *written[:k]):
            # A dataset may stand below (as in a folder that holds all of a run), and so may the store of an export.
            if folder == taken or taken in folder.parents:
                raise ConfigError(
                    f"{folder} is in {other}, {taken}", where=path, place=key, remedy="Give it a folder of its own."
                )
