"""tools/with-vcan on machines made of small scripts: which way it takes, and what it says.

The emulated machine itself is at work in tests/vcan.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from toolbox import ROOT, Machine
from vcan_machine import DEBIAN, EXTRA, GENERIC, forget_calls, vcan_machine, without

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="SocketCAN, and so tools/with-vcan, is Linux's"
)


@pytest.fixture
def runner(tmp_path: Path) -> Machine:
    """A hosted runner: Ubuntu, sudo without password, no user name spaces, no vcan."""
    return vcan_machine(tmp_path / "runner", user="sudoer", system="ubuntu")


@pytest.fixture
def debian(tmp_path: Path) -> Machine:
    """A bare Debian container, root's, on a kernel without vcan."""
    return vcan_machine(tmp_path / "debian", user="root", system="debian")


def test_a_hosted_runner_gets_its_own_kernels_vcan(runner: Machine) -> None:
    runner.package(EXTRA)
    done = runner.run("tools/with-vcan", "--install", "--check")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("direct: ")
    assert "made by sudo" in done.stdout
    assert any(EXTRA in call for call in runner.called("sudo: apt-get install"))
    assert runner.called("sudo: modprobe vcan")
    assert not [call for call in runner.calls if "qemu-system-x86" in call or "download" in call]


def test_a_runner_whose_module_is_not_to_be_had_takes_the_emulated_machine(
    runner: Machine,
) -> None:
    done = runner.run("tools/with-vcan", "--install", "--check")
    assert done.returncode == 0, done.stderr
    assert "emulated: COMMAND would run in a QEMU guest, because" in done.stdout
    assert "unshare: write failed" in done.stdout
    assert "this kernel has no vcan module" in done.stdout
    assert str(runner.cache / "meshpoint" / "with-vcan" / GENERIC) in done.stdout
    parts = " ".join(f"linux-{part}-{GENERIC}" for part in ("image", "modules", "modules-extra"))
    assert runner.called("apt-get -q download") == [f"apt-get -q download {parts}"]


def test_ubuntus_modules_are_unpacked_and_numbered(runner: Machine) -> None:
    """What is packed is seen on the way: its names go to cpio."""
    runner.package(EXTRA)  # known, but its vcan is another kernel's
    runner.program("cpio", 'cat >>"$FACTS/packed"; echo archive')
    runner.program("modprobe", (runner.bin / "modprobe").read_text().replace("-n*)", "never)"))
    runner.program("uname", "case $1 in -m) echo x86_64 ;; *) echo 6.99.0-other ;; esac")
    assert runner.run("tools/with-vcan", "--install").returncode == 0
    packed = (runner.facts / "packed").read_text().split()
    assert {"./modules/01-overlay.ko", "./modules/02-vcan.ko"} <= set(packed)
    assert not [name for name in packed if name.endswith(".zst")]


def test_debian_needs_the_image_alone(debian: Machine) -> None:
    done = debian.run("tools/with-vcan", "--install", "--check")
    assert done.returncode == 0, done.stderr
    assert "kernel has no vcan (Error: Unknown device type.)" in done.stdout
    assert debian.called("apt-get -q download") == [f"apt-get -q download linux-image-{DEBIAN}"]
    assert not debian.called("sudo")


def test_what_is_there_is_not_installed_again(debian: Machine) -> None:
    assert debian.run("tools/with-vcan", "--install").returncode == 0
    forget_calls(debian)
    done = debian.run("tools/with-vcan", "--install", "--check")
    assert done.returncode == 0, done.stderr
    assert not debian.called("apt-get install")
    assert not debian.called("apt-get -q download")


def test_nobody_needs_root_where_nothing_is_missing(tmp_path: Path) -> None:
    machine = vcan_machine(tmp_path, user="nobody", system="debian")
    machine.fact("vcan")
    machine.program("candump", "exit 0")
    done = machine.run("tools/with-vcan", "--install", "--check")
    assert done.returncode == 0, done.stderr
    assert "user name spaces of its own" in done.stdout
    assert not machine.called("apt-get")
    assert not machine.called("sudo")


def test_who_may_not_install_is_reported_what_root_should(tmp_path: Path) -> None:
    machine = vcan_machine(tmp_path, user="nobody", system="ubuntu")
    done = machine.run("tools/with-vcan", "--install", "true")
    assert done.returncode == 125
    assert "--install needs root for: apt-get install can-utils" in done.stderr
    assert not machine.called("apt-get install")


def test_check_alone_installs_nothing_and_says_what_would(runner: Machine) -> None:
    done = runner.run("tools/with-vcan", "--check")
    assert done.returncode == 3
    assert "impossible: not directly: " in done.stdout
    assert "qemu-system-x86_64 (package qemu-system-x86)" in done.stdout
    assert "with-vcan --install" in done.stdout
    assert "sudo " not in done.stdout.splitlines()[-1]
    assert not runner.called("apt-get")
    assert not runner.called("sudo: apt-get")


def test_a_kernel_that_apt_does_not_know_is_named(runner: Machine) -> None:
    for name in ("linux-image-virtual", "linux-image-generic"):
        (runner.facts / "apt" / name).unlink()
    done = runner.run("tools/with-vcan", "--install")
    assert done.returncode == 125
    assert "linux-image-amd64 linux-image-virtual linux-image-generic" in done.stderr
    assert "apt-get update" in done.stderr


def test_linux_image_generic_will_do_for_virtual(runner: Machine) -> None:
    (runner.facts / "apt" / "linux-image-virtual").unlink()
    assert runner.run("tools/with-vcan", "--install").returncode == 0
    assert (runner.cache / "meshpoint" / "with-vcan" / GENERIC / "complete").exists()


def test_a_failed_install_says_whose_messages_to_read(runner: Machine) -> None:
    runner.program("apt-get", "echo 'E: no space' >&2; exit 100")
    done = runner.run("tools/with-vcan", "--install")
    assert done.returncode == 125
    assert "E: no space" in done.stderr
    assert "apt-get could not install can-utils" in done.stderr
    assert "going on with the old lists" in done.stderr


def test_without_apt_get_the_packages_are_named(tmp_path: Path) -> None:
    machine = vcan_machine(tmp_path, user="root", system="debian")
    without(machine, "apt-get")
    done = machine.run("tools/with-vcan", "--install")
    assert done.returncode == 125
    assert "can-utils" in done.stderr
    done = machine.run("tools/with-vcan", "true")
    assert done.returncode == 125
    assert "nor in an emulated machine: its kernel is fetched with apt-get" in done.stderr


def test_root_runs_the_command_with_its_exit_status(debian: Machine) -> None:
    debian.fact("vcan")
    done = debian.run("tools/with-vcan", "sh", "-c", 'echo "$WITH_VCAN $A"; exit 7', A="b c")
    assert (done.returncode, done.stdout) == (7, "direct b c\n")
    assert "ip link set vcan0 mtu 72" not in done.stderr
    assert "ip link set dev vcan0 mtu 72" in debian.calls


def test_by_sudo_the_command_is_the_callers_with_all_its_environment(runner: Machine) -> None:
    runner.fact("vcan")
    runner.fact("module")
    asked = 'echo "$WITH_VCAN $(id -u) $PYTHONPATH $PATH"; exit 7'
    done = runner.run("tools/with-vcan", "sh", "-c", asked, PYTHONPATH="/p q")
    assert done.returncode == 7, done.stderr
    assert done.stdout == f"direct 1001 /p q {runner.bin}\n"
    assert runner.called("sudo: unshare --net --mount bash")
    assert runner.called("sudo: setpriv --reuid 1001")
    assert not list(runner.folder.glob("with-vcan.*"))


def test_sudo_is_left_alone_where_the_kernel_has_no_vcan(runner: Machine) -> None:
    """sudo reports to its administrator who may not use it."""
    assert runner.run("tools/with-vcan", "--check").returncode == 3
    assert not runner.called("sudo")


def test_the_time_limit_holds_directly(debian: Machine) -> None:
    debian.fact("vcan")
    assert debian.run("tools/with-vcan", "--timeout", "1", "sleep", "50").returncode == 124


def test_the_driver_that_debian_lacks_is_compiled_once_and_installs_nothing_else(
    debian: Machine,
) -> None:
    debian.fact("vcan")  # of no use here: it has no controllers
    debian.program("cpio", 'cat >>"$FACTS/packed"; echo archive')
    done = debian.run("tools/with-vcan", "--controllers", "--install", "--check")
    assert done.returncode == 0, done.stderr
    assert "only the emulated machine has the CAN controllers" in done.stdout
    assert f"{DEBIAN}-controllers" in done.stdout
    packages = f"linux-headers-{DEBIAN} linux-source-6.1 linux-headers-{DEBIAN}-common"
    assert debian.called("apt-get -q download") == [
        f"apt-get -q download linux-image-{DEBIAN}",
        f"apt-get -q download {packages}",
    ]
    assert not any("linux-" in call for call in debian.called("apt-get install"))
    packed = (debian.facts / "packed").read_text().split()
    assert any(name.endswith("-ctucanfd_pci.ko") for name in packed)
    forget_calls(debian)
    assert debian.run("tools/with-vcan", "--controllers", "--install").returncode == 0
    assert not debian.called("apt-get")
    assert not debian.called("make")


def test_a_kernel_that_has_the_driver_needs_no_source(debian: Machine) -> None:
    debian.fact("card")
    assert debian.run("tools/with-vcan", "--controllers", "--install").returncode == 0
    assert not any("linux-source" in call for call in debian.calls)
    assert not debian.called("make")


def test_without_controllers_nobody_pays_for_the_driver(debian: Machine) -> None:
    assert debian.run("tools/with-vcan", "--install").returncode == 0
    assert not any("linux-headers" in call or "gcc" in call for call in debian.calls)
    done = debian.run("tools/with-vcan", "--controllers", "--check")
    assert done.returncode == 3, "the kernel of vcan alone will not do"
    assert "missing: gcc (package gcc), make (package make)" in done.stdout
    assert "with-vcan --controllers --install" in done.stdout


def test_a_driver_that_cannot_be_compiled_is_said(debian: Machine) -> None:
    debian.fact("no-space")
    done = debian.run("tools/with-vcan", "--controllers", "--install")
    assert done.returncode == 125
    assert f"cannot prepare kernel {DEBIAN} with its CAN controllers" in done.stderr
    assert "No space left on device" in done.stderr
    (debian.facts / "apt" / "linux-source-6.1").unlink()
    done = debian.run("tools/with-vcan", "--controllers", "--install")
    assert done.returncode == 125
    assert f"kernel {DEBIAN} has no driver for CTU CAN FD" in done.stderr
    assert "linux-source-6.1: Debian has them" in done.stderr
    assert "apt-get update" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        ([], 125, "no command given"),
        (["--nonsense"], 125, "unknown option --nonsense (see --help)"),
        (["--timeout", "soon", "true"], 125, "--timeout takes a whole number, not 'soon'"),
        (["--cpus"], 125, "--cpus needs a value"),
        (["--check", "true"], 125, "--check runs nothing"),
        (["no-such-command"], 127, "no-such-command: command not found"),
        (["cangen"], 127, "can-utils, which with-vcan --install installs"),
        (["./no-such-file"], 127, "no such file"),
        (["/"], 126, "not executable"),
        (["--keep", "/proc", "true"], 125, "share a directory of your own"),
    ],
)
def test_what_is_wrong_with_the_call_is_said(
    debian: Machine, arguments: list[str], code: int, said: str
) -> None:
    done = debian.run("tools/with-vcan", *arguments)
    assert done.returncode == code
    assert said in done.stderr
    assert all(line.startswith("with-vcan: ") for line in done.stderr.splitlines())


def test_help_has_every_exit_code_in_80_columns(debian: Machine) -> None:
    done = debian.run("tools/with-vcan", "--help")
    assert done.returncode == 0
    assert max(len(line) for line in done.stdout.splitlines()) <= 80
    codes = done.stdout.split("Exit status")[1].split("Files")[0]
    assert set(re.findall(r"\b(?:12[4-7]|128\+N|[03])\b", codes)) == {
        "124", "125", "126", "127", "128+N", "0", "3",
    }  # fmt: skip


def test_the_workflow_installs_as_the_runners_user() -> None:
    """By `sudo tools/with-vcan` the guest's kernel would be fetched into root's home."""
    for name in (".github/workflows/ci.yml", "docs/ci.md", "Makefile"):
        assert not re.search(r"sudo +(\S*/)?with-vcan", (ROOT / name).read_text()), name
