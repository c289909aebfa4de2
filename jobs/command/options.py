"""Arguments and options that several verbs share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

__all__ = [
    "EXIT_CODES",
    "AsJson",
    "ConfigPath",
    "ExportPath",
    "Graphs",
    "Inline",
    "NavmeshRoots",
    "Overrides",
    "RefName",
    "RenewPriors",
    "RetryQuarantined",
    "SplitName",
    "TargetName",
]

ConfigPath = Annotated[Path, typer.Argument(metavar="CONFIG", help="YAML configuration of the run")]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", metavar="A.B=C", help="override one key; may be repeated")
]
TargetName = Annotated[
    str, typer.Argument(metavar="CONFIG|STORE", help="YAML configuration, or a store: its folder or s3://…")
]
RefName = Annotated[
    str | None, typer.Option("--ref", metavar="NAME", help="read this published name (ref) instead of the default")
]
AsJson = Annotated[bool, typer.Option("--json", help="print one JSON document instead of text")]

Inline = Annotated[bool, typer.Option("--inline", help="run in this process, without workers")]
RetryQuarantined = Annotated[bool, typer.Option("--retry-quarantined", help="try quarantined scenes again")]
RenewPriors = Annotated[bool, typer.Option("--priors", help="renew the label priors")]

ExportPath = Annotated[Path, typer.Argument(metavar="EXPORT", help="folder of an export")]
SplitName = Annotated[str, typer.Argument(metavar="SPLIT", help="train, val_seen, val_unseen or test")]
NavmeshRoots = Annotated[
    list[Path] | None,
    typer.Option("--navmesh-root", help="dataset folder with the navmeshes that the export does not ship"),
]
Graphs = Annotated[
    list[Path] | None,
    typer.Option("--connectivity", help="folder of <scan>_connectivity.json files, for discrete R2R"),
]

EXIT_CODES: Final = (
    "Exit codes: 0 done, 1 usage or a file that can't be written, 3 done with quarantined scenes or failed proofs, "
    "4 over the failure budget."
)
