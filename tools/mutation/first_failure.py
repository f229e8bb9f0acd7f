"""A test that fails under a mutant has caught it: hypothesis need not look for a smaller example.

That takes many times as long as the test, so that it would seem to be the mutant that never ends.
"""

from __future__ import annotations

from hypothesis import Phase, settings


def judge_by_first_failure() -> None:
    """For all tests that are loaded from here on."""
    quick = settings(settings.default, phases=(Phase.explicit, Phase.generate))
    settings.register_profile("mutants", quick)
    settings.load_profile("mutants")
