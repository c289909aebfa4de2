"""The examples that Hypothesis draws: always the same, new ones after each change of the code, or fresh ones.

``--draws fixed`` (the default) depends on the test alone. ``--draws code`` takes its seed from the project's Python
files: each change of the code is tried on new examples, and two runs of one state of it have the same outcome.
``--draws fresh`` picks a seed and prints it, ``--draws SEED`` draws those examples again. ``--rounds N`` runs each
property test N times, with N seeds in a row.
"""

from __future__ import annotations

import ast
import hashlib
import os
import secrets
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, Verbosity, core, settings
from hypothesis.internal.conjecture import providers

FIXED = "fixed"
FRESH = "fresh"
CODE = "code"
SEED_BITS = 32

ROUND = "draw_round"


def _register(name: str, *, derandomize: bool) -> None:
    """Every setting that is shared is named: Hypothesis has others where the variable CI is set."""
    settings.register_profile(
        name,
        derandomize=derandomize,
        # An example that failed once would come back in some runs and not in others. The blob repeats it.
        database=None,
        print_blob=True,
        # The machines are shared, and numba's first call alone takes seconds.
        deadline=None,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.differing_executors],
        max_examples=100,
        phases=tuple(Phase),
        verbosity=Verbosity.normal,
        stateful_step_count=50,
        report_multiple_bugs=True,
    )


_register(FIXED, derandomize=True)
_register(FRESH, derandomize=False)
settings.load_profile(FIXED)

# Hypothesis also draws constants that it finds in the source of the modules imported so far. Which ones those are
# depends on the tests that ran before in the same process. tests/test_draws.py fails where this line has no effect.
_NO_CONSTANTS = providers.Constants()
providers._get_local_constants = lambda: _NO_CONSTANTS


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("draws")
    group.addoption("--draws", default=FIXED, help="fixed (default), code, fresh, or a seed")
    group.addoption("--rounds", type=int, default=1, help="run each property test so many times, a seed each")


def pytest_configure(config: pytest.Config) -> None:
    chosen = config.option.draws
    if chosen == FRESH:
        # The processes of pytest-xdist get the options as they are now.
        chosen = config.option.draws = str(secrets.randbits(SEED_BITS))
    if chosen == CODE:
        chosen = config.option.draws = str(seed_of(config.rootpath))
    if chosen != FIXED:
        if not chosen.isdecimal():
            raise pytest.UsageError(f"--draws is fixed, code, fresh or a whole number, not {chosen!r}")
        settings.load_profile(FRESH)
    if config.option.rounds < 1 or (config.option.rounds > 1 and chosen == FIXED):
        raise pytest.UsageError("--rounds is a number from 1; more than one needs --draws code, fresh or a seed")


def seed_of(root: Path) -> int:
    """Return the seed of the Python code below a folder, without comments, docstrings, hidden folders and ``out``."""
    digest = hashlib.sha256()
    for folder, below, files in os.walk(root):
        below[:] = sorted(name for name in below if not name.startswith(".") and name != "out")
        for path in sorted(Path(folder, name) for name in files if name.endswith(".py")):
            for part in (path.relative_to(root).as_posix(), _code_of(path)):
                digest.update(hashlib.sha256(part.encode()).digest())
    return int.from_bytes(digest.digest()[: SEED_BITS // 8], "big")


def _code_of(path: Path) -> str:
    """Return what the parser makes of a Python file, without docstrings; the text itself where it can't be parsed."""
    text = path.read_text(encoding="utf-8")
    try:
        tree = ast.parse(text)
    except SyntaxError:
        return text
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            # A string that is a statement is a docstring, of a module, class, function or attribute.
            node.body = [part for part in body if not _is_string(part)]  # type: ignore[attr-defined]
    return ast.dump(tree)


def _is_string(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def pytest_report_header(config: pytest.Config) -> str:
    return _description(config)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    # At the end too: the header is not printed with -q.
    terminalreporter.write_line(_description(config))


def _description(config: pytest.Config) -> str:
    if config.option.draws == FIXED:
        return "Hypothesis draws the same examples in every run"
    return (
        f"Hypothesis draws from seed {config.option.draws}; repeat a failing test with "
        f"`pytest --draws {config.option.draws} --rounds {config.option.rounds} TEST`"
    )


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    rounds = metafunc.config.option.rounds
    if rounds > 1 and getattr(metafunc.function, "is_hypothesis_test", False):
        metafunc.fixturenames.append(ROUND)
        metafunc.parametrize(ROUND, range(rounds), indirect=True, ids=[f"round{k}" for k in range(rounds)])


@pytest.fixture
def draw_round(request: pytest.FixtureRequest) -> int:
    """Which of the ``--rounds`` this is."""
    number: int = request.param
    return number


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.config.option.draws == FIXED:
        core.global_force_seed = None
        return
    # A seed for each test, or tests of one strategy would all see the same examples.
    callspec = getattr(item, "callspec", None)
    number = callspec.params.get(ROUND, 0) if callspec is not None else 0
    name = item.nodeid.split("[")[0]
    text = f"{int(item.config.option.draws) + number} {name}"
    core.global_force_seed = int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")
