"""Is a wheel complete and alone? Standard input: the package's files as `git ls-files -z` has them.

The wheel has to hold each of them below `meshpoint/`, and nothing besides but compiled kernels and
its dist-info; so does what an installation has put into site-packages. Its description holds no
picture and no link that lead into the repository. Exit code 1, and what is wrong, otherwise.
"""

import re
import sys
import zipfile
from importlib.metadata import distribution
from pathlib import PurePosixPath

wheel = sys.argv[1]
tracked = [PurePosixPath(name) for name in sys.stdin.read().split("\0") if name]
wanted = {
    str(path if path.parts[0] == "meshpoint" else PurePosixPath("meshpoint", path))
    for path in tracked
}
held = {name for name in zipfile.ZipFile(wheel).namelist() if not name.endswith("/")}
held -= {name for name in held if name.split("/")[0].endswith(".dist-info")}
kernels = {name for name in held if name.startswith("meshpoint/kernels/compiled/")}
held -= kernels

installed = distribution("meshpoint")
tops = {file.parts[0] for file in installed.files or () if file.parts[0] != ".."}
outside = {str(file) for file in installed.files or () if file.parts[0] == ".."}

wrong = [f"missing in the wheel: {name}" for name in sorted(wanted - held)]
wrong += [f"in the wheel, not in the repository: {name}" for name in sorted(held - wanted)]
if not kernels:
    wrong.append("no compiled kernels in the wheel")
if tops != {"meshpoint", f"meshpoint-{installed.version}.dist-info"}:
    wrong.append(f"put into site-packages: {sorted(tops)}")
if {PurePosixPath(file).stem for file in outside} != {"meshpoint"}:
    wrong.append(f"put outside of site-packages: {sorted(outside)}")
described = str(installed.metadata.get_payload())
wrong += [
    f"leads into the repository, in the description: {link}"
    for link in re.findall(r"\]\((?!https?:)[^)]*\)", described)
]
if len(described) < 1000:
    wrong.append(f"no description: {described!r}")
for line in wrong:
    print(line, file=sys.stderr)
sys.exit(bool(wrong) or not wanted)
