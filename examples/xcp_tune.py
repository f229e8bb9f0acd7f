"""Reads or changes a setting of a running controller by XCP, with pyxcp (`pip install pyxcp`).

meshpoint up --xcp write --log run.log --header-dir .    # in another terminal
meshpoint a2l
python examples/xcp_tune.py meshpoint.a2l window.aim_slip_rpm       # reads it
python examples/xcp_tune.py meshpoint.a2l window.aim_slip_rpm 24    # and sets it
"""

import logging
import re
import struct
import sys
from pathlib import Path

import can
from pyxcp.config import create_application_from_config
from pyxcp.master import Master
from pyxcp.types import XcpResponseError


def main(a2l: str, name: str, wanted: str | None = None, channel: str | None = None) -> None:
    """Prints the setting's value, and what became of the wanted one."""
    text = Path(a2l).read_text("utf-8")
    found = re.search(rf"CHARACTERISTIC {re.escape(name)} .*\n\s*VALUE (\S+) float", text)
    if found is None:
        sys.exit(f"{a2l}: no setting {name} of this kind")
    address = int(found[1], 16)
    ids = re.findall(r"CAN_ID_(?:MASTER|SLAVE) (\S+)", text)
    to_slave, to_master = (int(each, 16) for each in ids)
    of_can = {"can_id_master": to_slave, "can_id_slave": to_master, "fd": True}
    settings = {"Transport": {"CAN": of_can}, "General": {"disable_error_handling": True}}
    config = create_application_from_config(settings, logging.ERROR)
    with (
        can.Bus(channel, interface="meshpoint") as bus,
        Master("can", config, transport_layer_interface=bus) as master,
    ):
        master.connect()
        fits = f'EPK "{master.identifier(1)}"' in text
        (value,) = struct.unpack("<f", master.shortUpload(4, address))
        said = f"{name} = {value:g}" if fits else f"{a2l}: of another version than the controller"
        if fits and wanted is not None:
            master.setMta(address)
            try:
                master.download(struct.pack("<f", float(wanted)))
                said += f", {wanted} from the next shift on"
            except XcpResponseError as error:
                said += f", {wanted} is refused: {error.args[0]}"
    print(said)


main(*sys.argv[1:])
