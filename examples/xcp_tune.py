"""Reads or changes a setting of a running controller by XCP, with pyxcp (`pip install pyxcp`).

meshpoint up --xcp write --log run.log --header-dir .    # in another terminal
meshpoint a2l
python examples/xcp_tune.py meshpoint.a2l window.aim_slip_rpm       # reads it
python examples/xcp_tune.py meshpoint.a2l window.aim_slip_rpm 24    # and sets it
"""

import argparse
import logging
import re
import struct
import sys
from pathlib import Path
from typing import Any

import can
from pyxcp.config import create_application_from_config
from pyxcp.master import Master
from pyxcp.types import XcpResponseError, XcpTimeoutError

HEADS = r"/begin CHARACTERISTIC (\S+)"


def setting(text: str, name: str) -> tuple[int, str]:
    """Address of a setting, and how its four bytes are packed."""
    found = re.search(rf"CHARACTERISTIC {re.escape(name)} .*\n\s*VALUE (\S+) (\w+)", text)
    if found is None:
        sys.exit(f"no setting {name}; the file has {', '.join(re.findall(HEADS, text))}")
    return int(found[1], 16), {"single_value": "<f", "whole_value": "<I"}[found[2]]


def master(text: str, bus: can.BusABC) -> Any:
    """pyxcp on this bus, with the identifiers of the A2L."""
    to_slave, to_master = (int(i, 16) for i in re.findall(r"CAN_ID_(?:MASTER|SLAVE) (\S+)", text))
    of_can = {"can_id_master": to_slave, "can_id_slave": to_master, "fd": True}
    settings = {"Transport": {"CAN": of_can}, "General": {"disable_error_handling": True}}
    config = create_application_from_config(settings, logging.CRITICAL)
    return Master("can", config, transport_layer_interface=bus)


def tune(text: str, name: str, wanted: float | None, bus: can.BusABC) -> str:
    """What is read, and what became of the wanted value."""
    address, form = setting(text, name)
    with master(text, bus) as one:
        try:
            one.connect()
        except XcpTimeoutError:
            return "no answer: is a controller running with --xcp?"
        if f'EPK "{one.identifier(1)}"' not in text:
            return "the A2L is of another version than the controller"
        (value,) = struct.unpack(form, one.shortUpload(4, address))
        said = f"{name} = {value:g}"
        if wanted is None:
            return said
        one.setMta(address)
        try:
            one.download(struct.pack(form, wanted if form == "<f" else round(wanted)))
        except XcpResponseError as error:
            return f"{said}, {wanted:g} is refused: {error.args[0]}"
        return f"{said}, now {wanted:g}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Reads or sets a setting of a controller by XCP.")
    parser.add_argument("a2l", type=Path, help="as `meshpoint a2l` writes it")
    parser.add_argument("name", help="of the setting, as window.aim_slip_rpm")
    parser.add_argument("value", type=float, nargs="?", help="to set; without it, it is read")
    parser.add_argument("-i", "--interface", default="meshpoint", help="python-can's interface")
    parser.add_argument("-c", "--channel", help="python-can's channel")
    given = parser.parse_args()
    with can.Bus(given.channel, interface=given.interface, fd=True) as opened:
        print(tune(given.a2l.read_text("utf-8"), given.name, given.value, opened))
