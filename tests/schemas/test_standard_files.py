"""Standard files that a caller has closed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(os.name != "posix", reason="closes files in the shell")


def said_by(code: str, closed: str, folder: Path) -> str:
    """Run a program whose standard files are closed as in a shell; return what it wrote to its file ``said``."""
    path = os.pathsep.join(filter(None, sys.path))
    subprocess.run(
        ["sh", "-c", f'exec "$0" -c "$1" {closed}', sys.executable, code],
        check=True, cwd=folder, env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    return (folder / "said").read_text()


@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-", ""])
def test_no_other_file_gets_their_numbers(tmp_path: Path, closed: str) -> None:
    code = (
        "import sys\nfrom schemas.standard_files import open_standard_files\nopen_standard_files()\n"
        "print('out')\nprint('error', file=sys.stderr)\nassert sys.stdin is not None\n"
        "with open('said', 'w') as file: file.write(str(file.fileno() > 2))\n"
    )
    assert said_by(code, closed, tmp_path) == "True"


def test_a_file_that_was_opened_before_is_left_alone(tmp_path: Path) -> None:
    code = (
        "import sys\nfile = open('said', 'w')\nassert file.fileno() == 2\n"
        "from schemas.standard_files import open_standard_files\nopen_standard_files()\n"
        "print('error', file=sys.stderr, flush=True)\nfile.write('mine')\nfile.close()\n"
    )
    assert said_by(code, "2>&-", tmp_path) == "mine"
