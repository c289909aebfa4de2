"""``make agents``: packages that could not be installed are tried again, and those that were are not."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

HERE = Path(__file__).parents[1]
SKIPPED = "requirements-trl.lock was not installed: the test of TRL will be skipped"
PIP = """#!/bin/sh
echo "$@" >> "{log}"
case "$*" in *requirements-trl.lock*) exit $(cat "{code}") ;; esac
"""


def test_a_package_that_was_not_installed_is_tried_again(tmp_path: Path) -> None:
    """torch's CPU build is not in every package index; the other packages are installed once all the same."""
    log, code, stamp = tmp_path / "log", tmp_path / "code", tmp_path / "env-agents" / ".trl"
    (tmp_path / "env").mkdir()
    (tmp_path / "env" / ".ready").touch()
    python = tmp_path / "env-agents" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text(PIP.format(log=log, code=code))
    python.chmod(0o755)
    # Newer than the lock files, whenever those were checked out.
    (tmp_path / "env-agents" / ".ready").touch()
    environment = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    calls = []
    for exit_code in (1, 1, 0, 0):
        code.write_text(str(exit_code))
        log.write_text("")
        run = ["make", "--no-print-directory", "agents", f"VENV={tmp_path / 'env'}", "PYTHON=false"]
        done = subprocess.run(run, cwd=HERE, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert (SKIPPED in done.stdout.splitlines()) == (exit_code == 1)
        asked = log.read_text()
        assert "test_agent_packages.py" in asked
        assert "requirements-agents.lock" not in asked
        calls.append(("requirements-trl.lock" in asked, stamp.exists()))
    assert calls == [(True, False), (True, False), (True, True), (False, True)]
