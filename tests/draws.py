"""What Hypothesis draws: the same examples for everyone, or fresh ones that can be drawn again.

``--draws fixed`` (the default) depends on the test alone. ``--draws fresh`` picks a seed and prints it, ``--draws
SEED`` draws those examples again. ``--rounds N`` runs each property test N times, with N seeds in a row; one that is
marked ``rounds(M)`` M times.
"""

from __future__ import annotations

import hashlib
import secrets

import pytest
from hypothesis import HealthCheck, Phase, Verbosity, core, settings
from hypothesis.internal.conjecture import providers

FIXED = "fixed"
FRESH = "fresh"
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
# depends on the tests that ran before in the same process.
_NO_CONSTANTS = providers.Constants()
providers._get_local_constants = lambda: _NO_CONSTANTS


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("draws")
    group.addoption("--draws", default=FIXED, help="fixed (default), fresh, or the seed of an earlier fresh run")
    group.addoption("--rounds", type=int, default=1, help="run each property test so many times, a seed each")


def pytest_configure(config: pytest.Config) -> None:
    chosen = config.option.draws
    if chosen == FRESH:
        # The processes of pytest-xdist get the options as they are now.
        chosen = config.option.draws = str(secrets.randbits(SEED_BITS))
    if chosen != FIXED:
        if not chosen.isdecimal():
            raise pytest.UsageError(f"--draws is fixed, fresh or a whole number, not {chosen!r}")
        settings.load_profile(FRESH)
    if config.option.rounds < 1 or (config.option.rounds > 1 and chosen == FIXED):
        raise pytest.UsageError("--rounds is a number from 1; more than one needs --draws fresh or a seed")


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
        asked = metafunc.definition.get_closest_marker("rounds")
        rounds = rounds if asked is None else asked.args[0]
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
