"""Opening a bus from the command line, in python-can's own arguments and configuration."""

import argparse
import configparser
import logging
import os
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import can
import can.cli
import can.util

from meshpoint.bus import given_numbers
from meshpoint.bus.kernel_drops import count_lost_frames
from meshpoint.bus.local.channel import ChannelError, TcpChannel, parse_channel
from meshpoint.bus.local.register import register_interface
from meshpoint.bus.profile import WireProfile
from meshpoint.bus.source_address import source_address, use_address
from meshpoint.bus.vendor_drivers import driver_words
from meshpoint.dbc.j1939 import CONTROLLER
from meshpoint.gearbox.reading import UnreadableError, read_text

DEFAULT_INTERFACE = "meshpoint"
IN_PROCESS = frozenset({"virtual", "meshpoint_simulated"})
"""Interfaces whose buses end at the process."""
BUS_TITLE = "which bus, as in python-can (`meshpoint help bus` explains)"
BUS_HELP = "-i --interface -c --channel -b --bitrate --fd --data-bitrate --config --address ..."
"""All that a command's help says of python-can's own arguments."""

# Interfaces that take fd=True without any further parameter.
_FD_BY_DEFAULT = frozenset({"socketcan", "udp_multicast", "kvaser", "vector"})
_UDP_DEFAULTS = {
    "channel": "239.74.163.2",  # python-can's own default is IPv6 and mostly delivers nothing
    "hop_limit": 0,  # frames stay on this machine
}
MOST_BIT_S = 20_000_000
"""Of CAN XL; CAN FD ends at 8 Mbit/s."""
CONFIG_LIMIT_BYTES = 1024 * 1024
CANFD_MTU = 72
"""Of a device that is set up for CAN FD; 16 for classic CAN."""
_CAN_DEVICE_TYPE = "280"  # ARPHRD_CAN
_NET_DEVICES = Path("/sys/class/net")
# Interfaces whose sockets drop frames when a reader is late: 278 FD frames fit into the usual one.
_LOSSY = frozenset({"socketcan", "udp_multicast"})
_RECEIVE_BUFFER_BYTES = 8 * 1024 * 1024
_SO_RCVBUFFORCE = 33  # linux/socket.h; Python has no name for it

_ARGUMENTS = ("channel", "interface", "bitrate", "fd", "data_bitrate", "timing")


class BusOpenError(Exception):
    """The bus that was asked for cannot be opened. The message is one line, for the user."""


def add_bus_arguments(parser: argparse.ArgumentParser, explained: bool = False) -> None:
    """Adds python-can's arguments (-i -c -b --fd --data-bitrate --timing --bus-kwargs), `--config`
    and `--address`.

    explained: help has a paragraph on each; else one line for all, which says where that is."""
    register_interface()
    own = len(parser._actions)
    can.cli.add_bus_arguments(parser)
    for action in parser._actions[own:]:
        if action.dest in ("bitrate", "data_bitrate"):
            action.type = given_numbers.whole(1, MOST_BIT_S)
    _add_config(parser)
    parser.add_argument(
        "--address",
        type=source_address,
        default=argparse.SUPPRESS,
        metavar="N",
        help="J1939 source address of the transmission controller on this bus; the same for all "
        f"nodes and tools on it (default: {CONTROLLER}, as in the DBC)",
    )
    if explained:
        _list_interfaces(parser)
        return
    for action in parser._actions[own:]:
        action.help = argparse.SUPPRESS
    parser.add_argument_group(BUS_TITLE, BUS_HELP)


def _list_interfaces(parser: argparse.ArgumentParser) -> None:
    """The interfaces' names once, where they wrap."""
    for action in parser._actions:
        if action.dest == "interface":
            action.metavar = "INTERFACE"
            action.help = f"one of {', '.join(sorted(can.VALID_INTERFACES))}"


def _add_config(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--config",
        default=argparse.SUPPRESS,
        metavar="[FILE/]SECTION",
        help="take the bus from a section of a python-can configuration file; FILE alone: its "
        "section 'default'; SECTION alone: of can.conf and the other usual files",
    )


def given_bus_arguments(namespace: argparse.Namespace) -> list[str]:
    """The bus arguments that were given, as words for another command's command line."""
    words = []
    for name in ("interface", "channel", "bitrate", "data_bitrate", "config", "address"):
        if name in namespace:
            words += [f"--{name.replace('_', '-')}", str(getattr(namespace, name))]
    if getattr(namespace, "fd", False):
        words.append("--fd")
    for name in ("timing", "bus_kwargs"):
        given = getattr(namespace, name, None)
        if given:
            pairs = [f"{key}={value}" for key, value in dict(given).items()]
            words += [f"--{name.replace('_', '-')}", *pairs]
    return words


def open_bus_from(namespace: argparse.Namespace) -> can.BusABC:
    """Opens the bus that arguments, `--config`, environment and python-can's configuration files
    ask for, in this order of precedence; the local bus of this user when none of them does.

    Raises BusOpenError.
    """
    config = bus_config(namespace)
    if getattr(namespace, "shadow", False):
        config |= LISTEN_ONLY.get(config["interface"], {})
    try:
        with _no_log_lines():
            bus = can.Bus(ignore_config=True, **config)
    except Exception as error:  # whatever a vendor's driver raises for a device that is not there
        raise BusOpenError(_open_error(config, error)) from error
    if bus.channel_info == can.BusABC.channel_info:
        bus.channel_info = _channel_info(config)
    if config["interface"] in _LOSSY:
        _enlarge_receive_buffer(bus)
    if config["interface"] == "socketcan":
        with suppress(OSError):  # a system that cannot tell what it lost
            count_lost_frames(bus)
    use_address(bus, controller_address(namespace))
    return bus


def controller_address(namespace: argparse.Namespace) -> int:
    """The controller's J1939 address on the bus that was asked for."""
    address: int = getattr(namespace, "address", CONTROLLER)
    return address


def bus_config(namespace: argparse.Namespace) -> dict[str, Any]:
    """The parameters for `can.Bus`, with CAN FD on where an interface has it.

    What environment and files say counts only when they mean the same interface: a channel of
    another one would be no channel here.

    Raises BusOpenError.
    """
    register_interface()
    given = {key: getattr(namespace, key) for key in _ARGUMENTS if key in namespace}
    given |= getattr(namespace, "bus_kwargs", {})
    try:
        if "config" in namespace:
            given = _section(namespace.config) | given
        ambient = can.util.load_file_config() | can.util.load_environment_config() | dict(can.rc)
        wanted, usual = given.get("interface"), ambient.get("interface")
        asked = ambient | given if wanted is None or usual in (None, wanted) else given
        is_classic = is_classic_profile(namespace)
        asked = _defaults(asked.get("interface", DEFAULT_INTERFACE), not is_classic) | asked
        # python-can casts values and builds bit timings; it also adds what we have left out.
        config = can.util.load_config(config=dict(asked))
    except can.CanInterfaceNotImplementedError as error:  # python-can's for an unknown name
        known = ", ".join(sorted(can.VALID_INTERFACES))
        raise BusOpenError(f"{error}; known interfaces are {known}") from error
    except (configparser.Error, ValueError, TypeError) as error:
        raise BusOpenError(f"bus configuration: {_one_line(str(error))}") from error
    wanted_keys = asked.keys() | ({"timing"} if "f_clock" in asked else set())
    result = {key: value for key, value in config.items() if key in wanted_keys}
    if result["interface"] == "socketcan":
        _check_socketcan(result.get("channel"), not is_classic)
    return result


def is_classic_profile(namespace: argparse.Namespace) -> bool:
    """Whether `--profile classic` was given: no bus needs CAN FD then."""
    return getattr(namespace, "wire", None) == WireProfile.CLASSIC


LISTEN_ONLY: dict[str, dict[str, Any]] = {
    "slcan": {"listen_only": True},
    "vector": {"listen_only": True},
    "kvaser": {"driver_mode": False},
    "pcan": {"state": can.BusState.PASSIVE},
}
"""What python-can takes, by interface, to open an adapter that never drives the bus: it does not
even acknowledge frames or send error frames."""


def listen_only_words(config: dict[str, Any]) -> str:
    """What a node that only listens does to this bus, in words. config: of `bus_config`."""
    interface = config["interface"]
    if interface in LISTEN_ONLY:
        return f"{interface} is opened listen-only: it does not even acknowledge frames"
    if interface == "socketcan":
        channel = config.get("channel")
        return (
            "nothing is sent, but the device acknowledges frames unless it is set up listen-only "
            f"(link down, then `ip link set {channel} type can listen-only on`)"
        )
    if interface in ("gs_usb", "socketcand", "ixxat", "usb2can"):
        return (
            f"nothing is sent, but python-can cannot open {interface} listen-only: the adapter "
            "acknowledges frames"
        )
    return f"nothing is sent; {interface} has no adapter that could acknowledge frames"


def _channel_info(config: dict[str, Any]) -> str:
    """What to call a bus that python-can leaves at "unknown", as it does udp_multicast."""
    port = f", port {config['port']}" if "port" in config else ""
    return f"{config['interface']} channel {config.get('channel', '(default)')}{port}"


def is_local_bus(namespace: argparse.Namespace) -> bool:
    """Whether the bus asked for cannot reach a valve: the local bus of this machine, or one that
    ends at the process (`IN_PROCESS`). A vcan is not: it may be bridged to a real bus.

    Raises BusOpenError.
    """
    config = bus_config(namespace)
    if config["interface"] != DEFAULT_INTERFACE:
        return config["interface"] in IN_PROCESS
    channel = config.get("channel")
    try:
        place = None if channel is None else parse_channel(str(channel))
    except ChannelError:
        return False  # opening it says why
    return not isinstance(place, TcpChannel) or place.is_local


def _defaults(interface: str, needs_fd: bool) -> dict[str, Any]:
    defaults: dict[str, Any] = {"interface": interface}
    if interface in _FD_BY_DEFAULT:
        defaults["fd"] = needs_fd
    if interface == "udp_multicast":
        defaults |= _UDP_DEFAULTS
    return defaults


def _section(text: str) -> dict[str, Any]:
    """The section of a configuration file that `--config` names."""
    head, slash, tail = text.rpartition("/")
    if Path(text).exists() and (slash or not Path(text).is_dir()):
        path, section = Path(text), "default"
    elif head and Path(head).exists():
        path, section = Path(head), tail
    elif not slash:
        found = can.util.load_file_config(section=text)
        if not found:
            files = ", ".join(can.util.CONFIG_FILES)
            raise BusOpenError(f"--config {text}: neither a file nor a section of {files}")
        return dict(found)
    else:
        raise BusOpenError(f"--config {text}: there is no file {head} (nor {text})")
    # As python-can reads its own files: keys keep their capitals.
    parser = configparser.ConfigParser()
    parser.optionxform = lambda name: name  # type: ignore[assignment,method-assign]
    try:
        parser.read_string(read_text(path, CONFIG_LIMIT_BYTES), str(path))
    except UnreadableError as error:
        raise BusOpenError(f"--config {text}: {error}") from error
    if not (parser.has_section(section) and parser.items(section)):
        sections = ", ".join(parser.sections()) or "none"
        raise BusOpenError(
            f"--config {text}: {path} has no settings in section {section!r}; sections: {sections}"
        )
    return dict(parser.items(section))


def _check_socketcan(channel: Any, needs_fd: bool) -> None:
    """Says what python-can would say late or not at all: that a device is missing or classic."""
    if channel is None:
        raise BusOpenError(f"interface socketcan needs a channel (-c); {_can_devices()}")
    mtu = _NET_DEVICES / str(channel) / "mtu"
    if not mtu.exists():
        return  # opening it says why
    if needs_fd and int(mtu.read_text()) < CANFD_MTU:
        raise BusOpenError(classic_refusal(str(channel)))


def classic_refusal(name: str) -> str:
    """Why a device that is set up for classic CAN cannot be used, and the ways out."""
    return (
        f"{name} is set up for classic CAN, but CAN FD is needed: set a real device up by "
        f"`ip link set {name} type can bitrate 500000 sample-point 0.8 "
        "dbitrate 2000000 dsample-point 0.8 fd on`, "
        f"a virtual one by `ip link set {name} mtu {CANFD_MTU}`; an adapter on which the first "
        "fails has no CAN FD: take one that has it, or start controller and rig with "
        "--profile classic"
    )


def _enlarge_receive_buffer(bus: can.BusABC) -> None:
    if sys.platform != "linux":
        return
    with socket.socket(fileno=os.dup(bus.fileno())) as same:
        same.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
        with suppress(PermissionError):  # only the administrator may go beyond the system's limit
            same.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _RECEIVE_BUFFER_BYTES)


def _can_devices() -> str:
    devices = sorted(
        entry.parent.name
        for entry in _NET_DEVICES.glob("*/type")
        if entry.read_text().strip() == _CAN_DEVICE_TYPE
    )
    return "this machine has " + (", ".join(devices) or "no CAN device")


def _open_error(config: dict[str, Any], error: Exception) -> str:
    interface, channel = config["interface"], config.get("channel")
    asked = f"interface {interface}, channel {'(default)' if channel is None else channel}"
    cause = _one_line(str(error)) or type(error).__name__
    if channel is None and isinstance(error, TypeError):
        cause = f"it needs a channel (-c) ({cause})"
    elif isinstance(error, ChannelError) and ":" not in str(channel):
        cause += f"; for a device named {channel} add -i with its interface"
    elif interface == "socketcan":
        cause += f"; {_can_devices()}"
    else:
        cause = driver_words(interface, error) or cause
    return f"cannot open {asked}: {cause}"


def _one_line(text: str) -> str:
    return " ".join(text.split())


@contextmanager
def _no_log_lines() -> Iterator[None]:
    """Keeps python-can from writing its own lines about an error that we report."""
    logger = logging.getLogger("can")
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        logger.setLevel(level)
