"""What a bus does to frames, asked of whichever bus python-can is configured for:

    CAN_INTERFACE=meshpoint_simulated python simulated_bus.py
    CAN_INTERFACE=virtual python simulated_bus.py
    CAN_INTERFACE=socketcan CAN_CHANNEL=vcan0 python simulated_bus.py

Nothing here knows meshpoint: `can.Bus()`, python-can's cyclic senders and error frames, and another
project's protocol, can-isotp (`pip install can-isotp`). The answers: docs/simulated_bus.md.
"""

import time

import can
import isotp

HIGH, LOW = 0x100, 0x700  # the lower identifier has the higher priority
FRAMES = 50
PAYLOAD = bytes(range(256)) * 15


def frame(can_id):
    """Eight bytes with a standard identifier."""
    return can.Message(arbitration_id=can_id, data=bytes(8), is_extended_id=False)


ERROR = can.Message(is_error_frame=True)
LOAD = (frame(0x010), 0.0004)  # seconds: some 60 % of a bus of 500 kbit/s
ERRORS = (ERROR, 0.050)
PATIENT = {"rx_flowcontrol_timeout": 30_000, "rx_consecutive_frame_timeout": 30_000}  # ms


def hear(bus, can_id, count):
    """What `bus` hears up to the last of a number of frames of an identifier."""
    messages = []
    while count:
        messages.append(bus.recv(60.0))
        if messages[-1] is None:
            raise TimeoutError(f"0x{can_id:X} was not heard")
        count -= messages[-1].arbitration_id == can_id
    return messages


def time_on_the_bus_ms(node, _, listener):
    """From the first of 50 frames to the last."""
    for _ in range(FRAMES):
        node.send(frame(HIGH))
    messages = hear(listener, HIGH, FRAMES)
    return round((messages[-1].timestamp - messages[0].timestamp) * 1e3, 1)


def frames_ahead(node, other, listener):
    """How many of a node's 50 frames go before one of higher priority that is handed over last."""
    for _ in range(FRAMES):
        node.send(frame(LOW))
    other.send(frame(HIGH))
    ahead = len(hear(listener, HIGH, 1)) - 1
    hear(listener, LOW, FRAMES - ahead)
    return ahead


def state_after_errors(node, *_):
    """Of a node that has met an error in 32 of its frames in a row."""
    for _ in range(32):
        node.send(ERROR)
    node.send(frame(HIGH))
    while node.recv(0.2):
        pass
    return node.state.name


def isotp_transfer(node, other, listener, *cyclic):
    """Milliseconds for 3,840 bytes by can-isotp, while `listener` sends these frames, each with its
    period; and how many error frames were heard meanwhile."""
    heard = can.BufferedReader()
    notifiers = can.Notifier(node, [heard], timeout=0.05), can.Notifier(other, [], timeout=0.05)
    sender, receiver = (
        isotp.NotifierBasedCanStack(
            bus, notifier, address=isotp.Address(txid=tx, rxid=rx), params=PATIENT
        )
        for bus, notifier, tx, rx in (
            (node, notifiers[0], 0x401, 0x402),
            (other, notifiers[1], 0x402, 0x401),
        )
    )
    tasks = [listener.send_periodic(message, period_s) for message, period_s in cyclic]
    sender.start()
    receiver.start()
    began_s = time.monotonic()
    sender.send(PAYLOAD)
    arrived = receiver.recv(block=True, timeout=60.0)
    took_ms = round((time.monotonic() - began_s) * 1e3)
    for part in (*tasks, sender, receiver, *notifiers):
        part.stop()
    if arrived != PAYLOAD:
        raise ValueError("what arrived is not what was sent")
    errors = 0
    while message := heard.get_message(0.0):
        errors += message.is_error_frame
    return took_ms, errors


QUESTIONS = (
    ("50 frames of 8 bytes, from the first to the last, ms", time_on_the_bus_ms),
    ("frames of 0x700 ahead of one 0x100 that is handed over as the 51st", frames_ahead),
    ("state of a node that has spoiled its own frame 32 times", state_after_errors),
    ("3,840 bytes by can-isotp, (ms, error frames)", isotp_transfer),
    ("the same beside a 0x010 each 0.4 ms", isotp_transfer, LOAD),
    ("the same with an error frame each 50 ms besides", isotp_transfer, LOAD, ERRORS),
)


def answers():
    """Each question with what three nodes on the bus found."""
    for question, ask, *cyclic in QUESTIONS:
        with can.Bus() as node, can.Bus() as other, can.Bus() as listener:
            yield question, ask(node, other, listener, *cyclic)


if __name__ == "__main__":
    for question, answer in answers():
        print(f"{question}: {answer}")
