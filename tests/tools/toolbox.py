"""A machine made of small scripts, for the shell scripts of tools/ to run on."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
REAL = (
    "awk", "basename", "bash", "busybox", "cat", "chmod", "cp", "cut", "date", "dd", "dirname",
    "env", "find", "flock", "grep", "head", "ls", "mkdir", "mktemp", "mv", "od", "printf", "ps",
    "readlink", "realpath", "rm", "sed", "sh", "sleep", "sort", "tail", "timeout", "touch", "tr",
    "true", "wc",
)  # fmt: skip
"""What the scripts may use of this machine; everything else is made here, or missing."""
PROGRAMS = {
    "iproute2": ("ip",),
    "can-utils": ("candump", "cansend"),
    "qemu-system-x86": ("qemu-system-x86_64",),
    "busybox-static": ("busybox",),
    "cpio": ("cpio",),
    "kmod": ("depmod",),
    "xz-utils": ("xz",),
    "zstd": ("zstd",),
    "gcc": ("gcc",),
    "make": ("make",),
    "binutils": ("strip",),
}
"""Which programs come with which package."""


class Machine:
    """A folder as PATH, HOME, and a folder of facts that its programs read.

    `calls` has every call of a program made here, one a line, with "sudo:" before those of root's.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.bin = folder / "bin"
        self.facts = folder / "facts"
        self.cache = folder / "cache"
        for made in (self.bin, self.facts, self.facts / "apt"):
            made.mkdir(parents=True)
        for name in REAL:
            if (found := shutil.which(name)) is not None and name != "busybox":
                (self.bin / name).symlink_to(found)

    def program(self, name: str, body: str) -> None:
        """A program `name`, of shell text; its call is written down first."""
        path = self.bin / name
        path.unlink(missing_ok=True)
        said = f'echo "${{AS_ROOT:+sudo: }}{name} $*" >>"$FACTS/calls"\n'
        path.write_text(f"#!{shutil.which('sh')}\n{said}{body}\n")
        path.chmod(0o755)

    def fact(self, name: str, value: str = "") -> None:
        """A file in the folder of facts."""
        (self.facts / name).write_text(value)

    def package(self, name: str, depends: str = "") -> None:
        """A package that apt knows."""
        (self.facts / "apt" / name).write_text(depends)

    @property
    def calls(self) -> list[str]:
        """Every call so far."""
        path = self.facts / "calls"
        return path.read_text().splitlines() if path.exists() else []

    def called(self, start: str) -> list[str]:
        """The calls that start so."""
        return [call for call in self.calls if call.startswith(start)]

    def run(self, script: str, *arguments: str, **more: str) -> subprocess.CompletedProcess[str]:
        """Runs a script of the repository there, with the environment given, to its end."""
        environment = {
            "PATH": str(self.bin),
            "HOME": str(self.folder),
            "XDG_CACHE_HOME": str(self.cache),
            "TMPDIR": str(self.folder),
            "FACTS": str(self.facts),
            **more,
        }
        bash = shutil.which("bash")
        assert bash is not None
        return subprocess.run(
            [bash, str(ROOT / script), *arguments],
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            cwd=self.folder,
            check=False,
        )


def link_from(machine: Machine) -> str:
    """Shell text that brings the programs of the packages named in "$@"."""
    cases = []
    for package, names in PROGRAMS.items():
        made = "; ".join(
            f'cp -- "$FACTS/../packed/{name}" "{machine.bin}/{name}"' for name in names
        )
        cases.append(f"{package}) {made} ;;")
    return 'for package in "$@"; do case $package in\n' + "\n".join(cases) + "\nesac; done"


def pack(machine: Machine, package: str) -> None:
    """Makes the programs of a package ready to be installed."""
    packed = machine.folder / "packed"
    packed.mkdir(exist_ok=True)
    for name in PROGRAMS[package]:
        machine.program(name, BODIES.get(name, "exit 0"))
        (machine.bin / name).replace(packed / name)


def install(machine: Machine, *packages: str) -> None:
    """Puts packages on the machine from the start."""
    for package in packages:
        for name in PROGRAMS[package]:
            shutil.copy2(machine.folder / "packed" / name, machine.bin / name)


# Compiles the modules of one folder, with headers that are reported where they are.
MAKE = """[ -e "$FACTS/no-space" ] && { echo 'No space left on device' >&2; exit 2; }
for word; do case $word in M=*) folder=${word#M=} ;; esac; done
grep -q "^include $2-common/" "$2/Makefile" || { echo 'no headers' >&2; exit 2; }
for name in ctucanfd ctucanfd_pci; do echo module >"$folder/$name.ko"; done"""
BODIES = {
    # The kernel: makes an interface if it has the module, as the fact says.
    "ip": """[ "$2" = add ] || exit 0
[ -e "$FACTS/vcan" ] && exit 0
echo 'Error: Unknown device type.' >&2
exit 2""",
    "cpio": "cat >/dev/null; echo archive",
    "make": MAKE,
    "zstd": 'for file in "$@"; do case $file in *.zst) mv "$file" "${file%.zst}" ;; esac; done',
    "xz": """[ "$1" = -dc ] && exec cat
for file in "$@"; do case $file in *.xz) mv "$file" "${file%.xz}" ;; esac; done""",
}
