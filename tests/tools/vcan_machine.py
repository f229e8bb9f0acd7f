"""Machines for tools/with-vcan: Debian and Ubuntu, with and without vcan, root and sudo."""

from __future__ import annotations

import shutil
from pathlib import Path

from toolbox import PROGRAMS, Machine, install, link_from, pack

AZURE = "6.11.0-1018-azure"
GENERIC = "6.8.0-31-generic"
DEBIAN = "6.1.0-56-amd64"
EXTRA = f"linux-modules-extra-{AZURE}"

APT_GET = """case $1 in
update) : ;;
install)
    [ "$(id -u)" = 0 ] || { echo 'E: are you root?' >&2; exit 100; }
    shift
    case " $* " in *" linux-modules-extra-"*) touch "$FACTS/module" ;; esac
    %s ;;
*)  # download
    shift 2
    for package in "$@"; do echo "$package" >"$package.deb"; done ;;
esac"""
APT_CACHE = """[ -e "$FACTS/apt/$2" ] || { echo 'E: No packages found' >&2; exit 100; }
case $1 in
show) echo "Package: $2" ;;
depends) echo "$2"; echo "  Depends: $(cat "$FACTS/apt/$2")"; echo '  Depends: firmware' ;;
esac"""
# Unpacks what the packages of Debian and of Ubuntu have, as far as the script looks at it.
DPKG = """package=$(cat "$2") tree=$3
case $1 in --fsys-tarfile) echo archive; exit ;; esac
mkdir -p "$tree/boot" "$tree/lib/modules"
case $package in
linux-headers-*-amd64)
    headers=$tree/usr/src/$package
    mkdir -p "$headers"
    echo "include /usr/src/$package-common/Makefile" >"$headers/Makefile" ;;
linux-image-*) head -c 2048 /dev/zero >"$tree/boot/vmlinuz-${package#linux-image-}" ;;
linux-modules-extra-*) echo module >"$tree/lib/modules/vcan.ko.zst" ;;
linux-modules-*) echo module >"$tree/lib/modules/overlay.ko.zst" ;;
esac
case $package in linux-image-*-amd64)
    for name in vcan overlay; do echo module >"$tree/lib/modules/$name.ko"; done
    [ ! -e "$FACTS/card" ] || echo module >"$tree/lib/modules/ctucanfd_pci.ko" ;;
esac"""
MODPROBE = """for name; do :; done
case $* in
*--show-depends*)
    tree=$2
    for file in $(find "$tree/lib/modules" -name "$name.ko*"); do
        echo "insmod $file"; exit 0
    done
    case $name in vcan|overlay|ctucanfd_pci)
        echo "modprobe: module $name not found" >&2; exit 1 ;;
    esac
    echo "builtin $name" ;;
*-n*) [ -e "$FACTS/module" ] ;;
*)
    [ -e "$FACTS/module" ] || exit 1
    [ "$(id -u)" = 0 ] && touch "$FACTS/vcan" ;;
esac"""
# Of the kernel's source, as much as is compiled.
TAR = """case $1 in
-xO) cat ;;
-x) cat >/dev/null; mkdir -p drivers/net/can/ctucanfd ;;
esac"""
UNSHARE = """while :; do case $1 in
--map-root-user) [ -e "$FACTS/no-user-namespaces" ] && {
    echo 'unshare: write failed /proc/self/uid_map: Operation not permitted' >&2; exit 1; } ;;
--*) ;;
*) break ;;
esac; shift; done
exec "$@\""""
# As sudo does: little is left of the caller's environment.
SUDO = """[ -e "$FACTS/sudoer" ] || { echo 'sudo: a password is required' >&2; exit 1; }
[ "$1" = -n ] && shift
exec env -i FACTS="$FACTS" PATH="$PATH" AS_ROOT=1 "$@\""""
SETPRIV = 'while [ "$1" != -- ]; do shift; done; shift; unset AS_ROOT; exec "$@"'


def vcan_machine(folder: Path, *, user: str, system: str) -> Machine:
    """A bare machine of `system` debian or ubuntu, used by `user` root, sudoer or nobody."""
    machine = Machine(folder)
    machine.program("apt-get", APT_GET % link_from(machine))
    machine.program("apt-cache", APT_CACHE)
    machine.program("dpkg", DPKG)
    machine.program("modprobe", MODPROBE)
    machine.program("unshare", UNSHARE)
    machine.program("setpriv", SETPRIV)
    machine.program("mount", "exit 0")
    machine.program("ldd", "exit 1")
    machine.program("ldconfig", "echo '  libelf.so.1 (libc6,x86-64) => /lib/libelf.so.1'")
    machine.program("tar", TAR)
    machine.program("uname", f"case $1 in -m) echo x86_64 ;; *) echo {AZURE} ;; esac")
    number = "0" if user == "root" else "1001"
    machine.program("id", f'[ "$AS_ROOT" ] && echo 0 || echo {number}')
    if user != "root":
        machine.program("sudo", SUDO)
    if user == "sudoer":
        machine.fact("sudoer")
    for package in PROGRAMS:
        pack(machine, package)
    install(machine, "iproute2")
    # The script looks into /usr/sbin too, where this machine may have a depmod of its own.
    machine.program("depmod", "exit 0")
    if system == "debian":
        machine.package("linux-image-amd64", f"linux-image-{DEBIAN}")
        machine.package(f"linux-image-{DEBIAN}")
        machine.package(f"linux-headers-{DEBIAN}", f"linux-headers-{DEBIAN}-common")
        machine.package("linux-source-6.1")
    else:
        machine.fact("no-user-namespaces")
        machine.package("linux-image-virtual", f"linux-image-{GENERIC}")
        machine.package("linux-image-generic", f"linux-image-{GENERIC}")
        for part in ("image", "modules", "modules-extra"):
            machine.package(f"linux-{part}-{GENERIC}")
    return machine


def forget_calls(machine: Machine) -> None:
    """What was called so far is not of interest."""
    (machine.facts / "calls").unlink(missing_ok=True)


def without(machine: Machine, name: str) -> None:
    """Takes a program away."""
    (machine.bin / name).unlink()
    assert shutil.which(name, path=str(machine.bin)) is None
