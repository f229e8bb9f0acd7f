"""In the closed loop: a gear comes out although the guard has blocked the brake's early air."""

from __future__ import annotations

import pytest
from drawn_shift import judged_shift

from meshpoint.rig_sim.settings import Profile

SEED, BEFORE = 2_000_182, 6
"""In the judged shift after these of this gearbox, 9 to 11, the sleeve comes out so slowly that the
air would come before its teeth are out."""


@pytest.mark.long
def test_a_gear_comes_out_although_the_guard_has_blocked_the_brakes_early_air() -> None:
    """The block takes the pulling valve off as well; early air again would be blocked again."""
    row = judged_shift(SEED, Profile.TYPICAL, BEFORE, 8)
    assert (row.result, row.fault) == ("engaged", "none")
