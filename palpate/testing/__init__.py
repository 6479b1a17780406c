"""Checks for plug-in authors; each raises an `AssertionError` that names the problem.

Call them from a test of the plug-in's own distribution::

    from palpate.testing import check_effect

    def test_swelling():
        check_effect(SWELLING)
"""

from palpate.testing.effect_checks import check_effect
from palpate.testing.law_checks import check_law
from palpate.testing.organ_checks import check_organ
from palpate.testing.search_checks import check_score, check_search

__all__ = ["check_effect", "check_law", "check_organ", "check_score", "check_search"]
