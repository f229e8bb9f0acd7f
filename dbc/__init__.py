"""The wire contract: what travels on the bus between gearbox, engine, controller and bench.

`meshpoint.dbc` is the one source. At import come from it: its checked content as data (`schema`),
typed messages in SI units (`messages`), the functions that encode and decode them (`layout`), and
the two ends of a node's link (`link`), which add and check AUTOSAR end-to-end protection (`e2e`).
This package knows no physics.

    from meshpoint.dbc.link import Receiver, Transmitter
    from meshpoint.dbc.messages import ValveAction, ValveCommand

    transmitter = Transmitter(Node.TRANSMISSION_CONTROL)
    frame = transmitter.encode(ValveCommand(brake_action=ValveAction.ON_NOW))
    verdict, message = Receiver(Node.GEARBOX_IO).receive(frame)
"""

from meshpoint.dbc.frame import Frame
from meshpoint.dbc.node import Node
from meshpoint.dbc.source import DBC_PATH, DBC_SHA256

__all__ = ["DBC_PATH", "DBC_SHA256", "Frame", "Node"]
