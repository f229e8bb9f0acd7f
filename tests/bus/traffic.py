"""A process of the bus tests: `send CHANNEL SOURCE COUNT RATE` or `listen CHANNEL SENDERS`.

Says "ready" when connected; a sender then waits for a line on its input. A frame's identifier is
its sender, its data begin with a sequence number; a frame without data is the sender's last.
"""

import hashlib
import json
import sys
import time

from meshpoint.bus.light_can import load_can

load_can()

import can  # noqa: E402

from meshpoint.bus.local.register import register_interface  # noqa: E402

LENGTHS = (8, 12, 16, 20, 24, 32, 48, 64)


def send(bus: can.BusABC, source: int, count: int, rate: float) -> None:
    begin = time.perf_counter()
    for number in range(count):
        data = number.to_bytes(4, "big") + bytes(LENGTHS[number % len(LENGTHS)] - 4)
        bus.send(can.Message(arbitration_id=source, data=data, is_fd=True, bitrate_switch=True))
        if rate:
            time.sleep(max(0.0, begin + (number + 1) / rate - time.perf_counter()))
    bus.send(can.Message(arbitration_id=source, is_fd=True))


def listen(bus: can.BusABC, senders: int) -> None:
    order = hashlib.sha256()
    expected: dict[int, int] = {}
    while senders:
        message = bus.recv(900.0)
        assert message is not None, f"silence, after {expected}"
        order.update(message.arbitration_id.to_bytes(4, "big") + bytes(message.data))
        if message.dlc == 0:
            senders -= 1
            continue
        number = int.from_bytes(message.data[:4], "big")
        assert number == expected.get(message.arbitration_id, 0), "a frame is missing"
        expected[message.arbitration_id] = number + 1
    print(json.dumps({"counts": expected, "order": order.hexdigest()}), flush=True)


def main() -> None:
    register_interface()
    role, channel, *numbers = sys.argv[1:]
    with can.Bus(channel=channel, interface="meshpoint", ignore_config=True) as bus:
        print("ready", flush=True)
        if role == "send":
            sys.stdin.readline()
            send(bus, int(numbers[0]), int(numbers[1]), float(numbers[2]))
        else:
            listen(bus, int(numbers[0]))


if __name__ == "__main__":
    main()
