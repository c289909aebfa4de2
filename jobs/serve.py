"""``condvln serve``: a split as an OpenEnv server."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from condvln.evaluation.tools import tools_for
from jobs.looker import datasets_of

__all__ = ["serve_split"]


def serve_split(
    export: Path, split: str, datasets: Sequence[str], roots: Sequence[Path], host: str, port: int, sessions: int
) -> None:
    """Serve a split until the process is ended.

    Parameters
    ----------
    datasets : ``FAMILY=FOLDER`` each, of what agents see
    sessions : how many may be open at once

    Raises
    ------
    UsageError : openenv is not installed, or the split is empty
    """
    from condvln.evaluation.openenv_server import application

    tools = tools_for(export, split, datasets_of(datasets), roots=tuple(roots))
    app = application(tools, sessions)
    import uvicorn

    uvicorn.run(app, host=host, port=port)
