"""What the system reports about a CAN interface: `ip -details -json link show`, and the socket.

Only SocketCAN devices have such facts. A vcan has no bit rate and no error counter, another
interface has no link at all: then it is said what cannot be known.
"""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Final

import can

from meshpoint.bus.options import CANFD_MTU, classic_refusal
from meshpoint.bus.profile import WireProfile
from meshpoint.commission.finding import Finding, Verdict

GROUP: Final = "interface"
ARBITRATION_BIT_S: Final = 500_000
DATA_BIT_S: Final = 2_000_000
SAMPLE_POINTS: Final = (0.75, 0.90)
"""Of the arbitration phase; CiA 601-3 recommends 80 % at 500 kbit/s, J1939-14 87.5 %. Nodes of
one bus should have the same."""
LEAST_QUEUE: Final = 100
"""Frames. A step sends up to ten at once, which alone fill the kernel's usual queue of 10."""
LEAST_BUFFER_BYTES: Final = 1 << 20
"""278 CAN FD frames fit into the usual 212,992 bytes: 0.3 s of our bus."""
IP_TIMEOUT_S: Final = 10.0
NO_FACTS: Final = "bit rates, sample point, restart-ms, queue length and error counters"


@dataclass(frozen=True)
class LinkState:
    """One CAN device as `ip` says it; None: it does not say."""

    name: str
    is_up: bool
    mtu: int | None
    kind: str | None
    """`can` for a controller, `vcan` for a virtual bus."""
    queue_frames: int | None
    state: str | None = None
    is_fd: bool | None = None
    is_listen_only: bool = False
    bit_s: int | None = None
    data_bit_s: int | None = None
    sample_point: float | None = None
    data_sample_point: float | None = None
    restart_ms: int | None = None
    errors_now: tuple[int, int] | None = None
    """The controller's error counters, transmit and receive."""
    counts: dict[str, int] = field(default_factory=dict)
    """Bus errors, bus-offs and so on since the link was set up; dropped frames."""


class LinkError(Exception):
    """The system says nothing of this device; the message says why."""


def read_link(name: str) -> LinkState:
    """Asks `ip`. LinkError where there is none, or no such device."""
    tool = shutil.which("ip")
    if tool is None:
        raise LinkError("there is no `ip` on this machine (package iproute2)")
    reported = subprocess.run(  # noqa: S603 (the name is one argument, no shell)
        [tool, "-details", "-statistics", "-json", "link", "show", "dev", name],
        capture_output=True,
        text=True,
        timeout=IP_TIMEOUT_S,
        check=False,
    )
    if reported.returncode != 0:
        raise LinkError(
            " ".join(reported.stderr.split()) or f"`ip` ended with {reported.returncode}"
        )
    return link_of(reported.stdout)


def link_of(text: str) -> LinkState:
    """The state that `ip -details -statistics -json` printed. LinkError where it is none."""
    try:
        found = json.loads(text)
        device = next(entry for entry in found if entry)
    except (ValueError, StopIteration, TypeError) as error:
        raise LinkError("what `ip` printed is no link") from error
    info = device.get("linkinfo", {})
    data = info.get("info_data", {})
    modes = data.get("ctrlmode", [])
    timing, data_timing = data.get("bittiming", {}), data.get("data_bittiming", {})
    errors = data.get("berr_counter")
    kind = info.get("info_kind")
    return LinkState(
        name=device["ifname"],
        is_up="UP" in device.get("flags", []),
        mtu=device.get("mtu"),
        kind=kind,
        queue_frames=device.get("txqlen"),
        state=data.get("state"),
        is_fd=("FD" in modes) if kind == "can" else None,
        is_listen_only="LISTEN-ONLY" in modes,
        bit_s=timing.get("bitrate"),
        data_bit_s=data_timing.get("bitrate"),
        sample_point=_share(timing.get("sample_point")),
        data_sample_point=_share(data_timing.get("sample_point")),
        restart_ms=data.get("restart_ms", 0 if kind == "can" else None),
        errors_now=None if errors is None else (errors["tx"], errors["rx"]),
        counts=_counts(device, info),
    )


def _share(reported: Any) -> float | None:
    """A sample point: older versions of `ip` print text, others a number."""
    return None if reported is None else float(reported)


def _counts(device: dict[str, Any], info: dict[str, Any]) -> dict[str, int]:
    counts = {key: int(value) for key, value in info.get("info_xstats", {}).items()}
    statistics = device.get("stats64", device.get("stats", {}))
    for way in ("rx", "tx"):
        if "dropped" in statistics.get(way, {}):
            counts[f"{way}_dropped"] = int(statistics[way]["dropped"])
    return counts


def judge_link(
    link: LinkState,
    before: LinkState | None = None,
    profile: WireProfile = WireProfile.FD,
) -> Iterator[Finding]:
    """What the state of a link means. before: the same link some seconds earlier."""
    is_classic = profile is WireProfile.CLASSIC
    if not link.is_up:
        yield _bad("link", f"{link.name} is down: `ip link set {link.name} up`")
    else:
        yield _good("link", f"{link.name} is up")
    if is_classic:
        yield _good("CAN FD", f"mtu {link.mtu}; --profile classic needs none")
    elif link.mtu is not None and link.mtu < CANFD_MTU:
        yield _bad("CAN FD", classic_refusal(link.name))
    else:
        yield _good("CAN FD", f"mtu {link.mtu}")
    if link.kind != "can":
        yield _unknown(
            "bit timing",
            f"{link.kind or 'this kind of device'} has no CAN controller: {NO_FACTS} mean nothing",
        )
        return
    yield from _judge_timing(link, is_classic)
    yield _judge_restart(link)
    yield from _judge_queue(link)
    yield from _judge_errors(link, before)


def _judge_timing(link: LinkState, is_classic: bool) -> Iterator[Finding]:
    if link.bit_s is None:
        yield _unknown("bit rate", "`ip` reports none")
        return
    rates = f"{link.bit_s / 1e3:g} kbit/s"
    rates += f", data {link.data_bit_s / 1e6:g} Mbit/s" if link.data_bit_s else ", no data bit rate"
    right = link.bit_s == ARBITRATION_BIT_S and (is_classic or link.data_bit_s == DATA_BIT_S)
    wanted = "500 kbit/s" if is_classic else "500 kbit/s and 2 Mbit/s"
    yield (
        _good("bit rate", rates)
        if right
        else _bad("bit rate", f"{rates}; the contract has {wanted}")
    )
    if link.sample_point is None:
        yield _unknown("sample point", "`ip` reports none")
        return
    points = f"{100 * link.sample_point:.1f} %"
    if link.data_sample_point is not None:
        points += f", data {100 * link.data_sample_point:.1f} %"
    low, high = SAMPLE_POINTS
    if low <= link.sample_point <= high:
        yield _good("sample point", f"{points}; the other nodes should have the same")
    else:
        yield _bad("sample point", f"{points}, outside {100 * low:g} to {100 * high:g} %")


def _judge_restart(link: LinkState) -> Finding:
    if link.state == "BUS-OFF":
        after = (
            f"restarts by itself after {link.restart_ms} ms"
            if link.restart_ms
            else f"stays so, as restart-ms is 0: `ip link set {link.name} type can restart`, or "
            f"{link.name} down and up where the driver cannot"
        )
        return _bad("controller state", f"BUS-OFF, the node is off the bus and {after}")
    if not link.restart_ms:
        return _bad(
            "restart-ms",
            "0: after a bus-off the node would stay off the bus for ever; with the link down, "
            f"`ip link set {link.name} type can restart-ms 100`",
        )
    return _good("restart-ms", f"{link.restart_ms} ms, state {link.state}")


def _judge_queue(link: LinkState) -> Iterator[Finding]:
    frames = link.queue_frames
    if frames is None:
        yield _unknown("transmit queue", "`ip` reports no length")
    elif frames < LEAST_QUEUE:
        yield _bad(
            "transmit queue",
            f"{frames} frames: a busy bus fills it and frames are refused (ENOBUFS); "
            f"`ip link set {link.name} txqueuelen 1000`",
        )
    else:
        yield _good("transmit queue", f"{frames} frames")


def _judge_errors(link: LinkState, before: LinkState | None) -> Iterator[Finding]:
    state = link.state or "unknown"
    if state in ("ERROR-WARNING", "ERROR-PASSIVE"):
        yield _bad(
            "controller state",
            f"{state}: wiring, termination, bit rates, or nobody else on the bus to acknowledge",
        )
    counted = " ".join(f"{key} {value}" for key, value in sorted(link.counts.items()))
    now = "" if link.errors_now is None else "tx {} rx {} now; ".format(*link.errors_now)
    grown = {
        key: value - before.counts.get(key, 0)
        for key, value in link.counts.items()
        if before is not None and value > before.counts.get(key, 0)
    }
    if grown:
        reported = ", ".join(f"{key} +{value}" for key, value in sorted(grown.items()))
        yield _bad("error counters", f"{reported} while listening")
    else:
        yield _good("error counters", f"{now}{counted}" or "none reported")


def judge_socket(bus: can.BusABC) -> Finding:
    """The receive buffer of a bus that has a socket of the kernel."""
    if sys.platform != "linux":
        return _unknown("receive buffer", "no socket of the kernel that could be asked")
    inner = getattr(bus, "socket", None)
    if inner is None or not hasattr(inner, "getsockopt"):
        return _unknown("receive buffer", "no socket of the kernel that could be asked")
    size = inner.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    if size < LEAST_BUFFER_BYTES:
        return Finding(
            GROUP, "receive buffer", Verdict.NOTE,
            f"{size} bytes: some 0.3 s of this bus, then frames are lost where the machine keeps "
            "the node from reading; `sysctl net.core.rmem_max=8388608`, or run it as administrator",
        )  # fmt: skip
    return _good("receive buffer", f"{size} bytes")


def without_link(interface: str) -> Finding:
    """An interface that is no SocketCAN device."""
    hint = ": the adapter's own tool shows them" if interface not in NO_CONTROLLER else ""
    return _unknown("bit timing", f"{interface} reports no {NO_FACTS}{hint}")


NO_CONTROLLER: Final = frozenset({"meshpoint", "meshpoint_simulated", "virtual", "udp_multicast"})
"""Interfaces without any CAN controller."""


def _good(subject: str, text: str) -> Finding:
    return Finding(GROUP, subject, Verdict.GOOD, text)


def _bad(subject: str, text: str) -> Finding:
    return Finding(GROUP, subject, Verdict.BAD, text)


def _unknown(subject: str, text: str) -> Finding:
    return Finding(GROUP, subject, Verdict.UNKNOWN, text)
