"""What holds for all tests: hypothesis draws the same examples in every run, and judges what is
computed, not how fast a busy machine computes it.

Look for new examples with `pytest --hypothesis-profile=explore`.

Makes `patience` importable, by which live tests wait.
"""

import sys
from pathlib import Path

from hypothesis import HealthCheck, settings

sys.path.insert(0, str(Path(__file__).parent))

UNTIMED = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("explore", UNTIMED)
settings.register_profile("same", UNTIMED, derandomize=True, database=None)
settings.load_profile("same")
