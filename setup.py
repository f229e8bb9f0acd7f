"""Which folder is which package: four of them lie beside `meshpoint/` in the repository. And
README as a package index can show it, and the compiled kernels that a wheel brings."""

import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py

BESIDE = ("controller", "dbc", "firmware", "rig_sim")
PICTURE = re.compile(r"!\[[^\]]*\]\((?!https?:)[^)\s]+\)\n*")
LINK = re.compile(r"(?<!!)\[([^\]]+)\]\((?!https?:|#)([^)\s]+)\)")
FENCE = re.compile(r"(^```.*?^```$)", re.MULTILINE | re.DOTALL)
NOTE = """\
*This is the README of the repository, without its pictures. The files it names, docs/ and examples/
among them, are there, and so is the Makefile: with the package installed, `meshpoint demo` does
what `make demo` does.*
"""


def description(readme: str) -> str:
    """README for a package index, which has none of the files beside it: pictures are left out,
    links into the repository become text, and a note below the title says so."""
    parts = FENCE.split(readme)
    parts[::2] = (LINK.sub(_words, PICTURE.sub("", part)) for part in parts[::2])
    title, _, rest = "".join(parts).partition("\n")
    return f"{title}\n\n{NOTE}{rest}"


def _words(link: re.Match[str]) -> str:
    """A link as text that still says which file it means."""
    text, file = link[1], link[2].partition("#")[0].rstrip("/")
    return text if file in text or f"{file}/" in text else f"{text} ({file})"


class BuildWithKernels(build_py):
    """Puts the kernels for this Python and kind of processor beside what was built, where numba is
    installed (no build isolation). Without them the first run compiles."""

    def run(self) -> None:
        """As a command of setuptools."""
        super().run()
        if self.editable_mode:
            return
        if find_spec("numba") is None:
            self.warn("built without compiled kernels: numba is not installed here")
            return
        built = Path(self.build_lib).resolve()
        subprocess.run(  # noqa: S603 (ours)
            [sys.executable, "-B", "-m", "meshpoint.bench.compiling", "ship",
             str(built / "meshpoint" / "kernels" / "compiled")],
            env={**os.environ, "PYTHONPATH": str(built)}, cwd=built, check=True,
        )  # fmt: skip


if __name__ == "__main__":
    setup(
        cmdclass={"build_py": BuildWithKernels},
        long_description=description(Path(__file__).with_name("README.md").read_text("utf-8")),
        long_description_content_type="text/markdown",
        package_dir={f"meshpoint.{name}": name for name in BESIDE},
        packages=[
            *find_packages(include=["meshpoint", "meshpoint.*"]),
            *(
                f"meshpoint.{found}"
                for name in BESIDE
                for found in find_packages(include=[name, f"{name}.*"])
            ),
        ],
    )
