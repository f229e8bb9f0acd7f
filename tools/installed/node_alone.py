"""Is a node alone as small as a page says? Runs where meshpoint is installed.

    node_alone.py docs/support.md

The page has the packages, in the last `pip install` with a constraints file, and the most MB, in
"under 280 MB". Counted are their files and those of all they need, without bytecode. Exit code 1
if it is more.
"""

import re
import sys
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

PAGE = Path(sys.argv[1]).read_text(encoding="utf-8")
PACKAGES = re.findall(r"meshpoint\.constraints\)\" ([a-z0-9 -]+)$", PAGE, re.MULTILINE)[-1].split()
MOST_MB = int(re.findall(r"under (\d+) MB:", PAGE)[0])


def needed(names: list[str]) -> dict[str, Distribution]:
    """These packages, and all that they need here without an extra."""
    found: dict[str, Distribution] = {}
    while names:
        name = names.pop()
        if name in found:
            continue
        try:
            found[name] = distribution(name)
        except PackageNotFoundError:  # for another system or Python
            continue
        wanted = (line for line in found[name].requires or () if "extra ==" not in line)
        names += (re.split(r"[^A-Za-z0-9._-]", line)[0].lower() for line in wanted)
    return found


def taken_mb(package: Distribution) -> float:
    """As `du` counts them: in blocks of 4 KB."""
    files = (Path(str(file.locate())) for file in package.files or () if file.suffix != ".pyc")
    return sum(-(-path.stat().st_size // 4096) * 4096 for path in files if path.is_file()) / 2**20


parts = {name: taken_mb(package) for name, package in needed(PACKAGES).items()}
parts["meshpoint"] = taken_mb(distribution("meshpoint"))
whole_mb = sum(parts.values())
for name, mb in sorted(parts.items(), key=lambda part: -part[1])[:8]:
    print(f"{mb:5.0f} MB {name}")
print(f"{whole_mb:5.0f} MB a node alone, at most {MOST_MB} MB")
sys.exit(whole_mb > MOST_MB)
