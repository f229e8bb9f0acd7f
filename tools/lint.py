"""Holds documents and sources to the rules of tools/rules: words, names, links, where files are
opened, how messages are printed.

    python tools/lint.py [RULE ...]

Says each place that breaks one, and ends with 1 where there is any.
"""

from __future__ import annotations

import argparse
import sys

from rules import (
    bench,
    decisions,
    docstrings,
    documents,
    glossary,
    house,
    opening,
    printing,
    releases,
    support,
)

MODULES = (
    bench,
    decisions,
    docstrings,
    documents,
    glossary,
    house,
    opening,
    printing,
    releases,
    support,
)
RULES = {module.__name__.rpartition(".")[2]: module for module in MODULES}


def main(argv: list[str] | None = None) -> int:
    """Runs the rules that are named, or all."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("rules", nargs="*", metavar="RULE", help=f"of {', '.join(RULES)}")
    named = parser.parse_args(argv).rules or list(RULES)
    if unknown := sorted(set(named) - set(RULES)):
        parser.error(f"no such rule: {', '.join(unknown)}; there are {', '.join(RULES)}")
    found = [f"{finding} [{name}]" for name in named for finding in RULES[name].findings()]
    for finding in found:
        print(finding)
    print(f"{len(named)} rules of tools/rules: {len(found)} findings")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
