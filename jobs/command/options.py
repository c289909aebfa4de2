"""Arguments and options that several verbs share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

__all__ = [
    "EXIT_CODES",
    "AsJson",
    "ConfigPath",
    "Datasets",
    "ExportPath",
    "ForwardStep",
    "Graphs",
    "Inline",
    "LookerKeys",
    "Overrides",
    "RefName",
    "RenewPriors",
    "RetryQuarantined",
    "SplitName",
    "TargetName",
]

ConfigPath = Annotated[Path, typer.Argument(metavar="CONFIG", help="YAML configuration of the run")]
Overrides = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        "--data",
        metavar="A.B=C|FAMILY=DIR",
        help="override one key, or name the folder where a family's scenes lie; may be repeated",
    ),
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
SplitName = Annotated[
    str, typer.Argument(metavar="SPLIT", help="train, val_seen, val_unseen or test; test:procthor for one source of it")
]
ForwardStep = Annotated[
    float | None,
    typer.Option(
        "--forward-step",
        metavar="METRES",
        help="length of the agents' action forward; by default that of the export's configuration for VLN-CE, 0.25",
    ),
]
Graphs = Annotated[
    list[Path] | None,
    typer.Option("--connectivity", help="folder of <scan>_connectivity.json files, for discrete R2R"),
]

Datasets = Annotated[
    list[str] | None,
    typer.Option(
        "--data",
        metavar="[FAMILY=]DIR",
        help="dataset in which agents see the scenes, or what they saw is checked; a folder without its family gives "
        "navmeshes alone; may be repeated; by default as noted beside the export where it was made",
    ),
]
LookerKeys = Annotated[
    list[str] | None,
    typer.Option(
        "--looker", metavar="KEY=VALUE", help="set a key of looker, such as noise.missed=0.1; may be repeated"
    ),
]

EXIT_CODES: Final = (
    "Exit codes: 0 done, 1 wrong usage, or the store or the disk refused, 3 an input that can't be used, quarantined "
    "scenes or a failed check, 4 over the failure budget, 130 stopped by Ctrl-C."
)
