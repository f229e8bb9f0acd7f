"""Asks a gearbox behind a Jumpstarter exporter (exporter.yaml) for a gear, and waits for it.

Plain J1939 by Jumpstarter's own client, which is a python-can bus; nothing here knows meshpoint.
"""

import sys

import can
from jumpstarter.common.utils import env

TC1 = 0x0C0103F9  # PGN 256, from an off-board tool to the transmission; SPN 525 in byte 3
ETC2 = 0x18F00503  # PGN 61445, each 100 ms; SPN 523 in byte 4
GEAR_0 = 125


def main(gear):
    """Exit code 1 where the gear is not in after 10 s of bus time."""
    with env() as client:
        bus = client.can
        bus.set_filters([{"can_id": ETC2, "can_mask": 0x1FFFFFFF, "extended": True}])
        bus.send(can.Message(arbitration_id=TC1, data=[0xFF, 0xFF, GEAR_0 + gear, *[0xFF] * 5]))
        for _ in range(100):
            status = bus.recv(60.0)
            if status is None:
                break
            if status.data[3] == GEAR_0 + gear:
                print(f"in gear {gear}")
                return 0
    print(f"gear {gear} was not engaged", file=sys.stderr)
    return 1


if __name__ == "__main__":
    raise SystemExit(main(int(sys.argv[1])))
