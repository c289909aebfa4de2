"""Random choices: short streams are the beginnings of long ones."""

from __future__ import annotations

import numpy as np
import pytest

from condvln.seeding import BLOCK, FEW, Draws, FewDraws, generator


@pytest.mark.parametrize("count", [1, FEW, FEW + 1, BLOCK, BLOCK + 1, BLOCK + FEW, BLOCK + FEW + 1, 3 * BLOCK])
def test_few_draws_are_those_of_whole_blocks(count: int) -> None:
    """At each end of a part and of a block, and beyond."""
    whole, few = (kind(generator(0, "few", count)) for kind in (Draws, FewDraws))
    assert [few.uniform() for _ in range(count)] == [whole.uniform() for _ in range(count)]


def test_other_generators_draw_whole_blocks() -> None:
    whole, few = (kind(np.random.Generator(np.random.MT19937(3))) for kind in (Draws, FewDraws))
    assert [few.uniform() for _ in range(2 * BLOCK)] == [whole.uniform() for _ in range(2 * BLOCK)]


def test_a_kernel_takes_no_part_of_a_block() -> None:
    with pytest.raises(TypeError, match="whole blocks"):
        FewDraws(generator(0, "few")).compiled(lambda stream, left: 0)
