"""A process of the log tests: writes frames to log FILEs, 1000 a second, until it is killed.

With a SIZE of more than 0 bytes it writes parts of that many."""

import itertools
import os
import sys
import time
from pathlib import Path

from meshpoint.bus.light_can import load_can

load_can()

from meshpoint.bus.logs.files import RotatingLog  # noqa: E402
from meshpoint.bus.logs.recorder import LogWriter  # noqa: E402
from meshpoint.dbc.frame import Frame  # noqa: E402


def main() -> None:
    size, paths = int(sys.argv[1]), [Path(name) for name in sys.argv[2:]]
    logs = [RotatingLog(path, size, channel="vcan0") if size else LogWriter(path) for path in paths]
    began = time.time()
    for number in itertools.count():
        frame = Frame(0x18FF0001, number.to_bytes(4, "big") + os.urandom(44))
        for log in logs:
            log.write(time.time(), frame)
        if number == 10:
            print("ready", flush=True)
        time.sleep(max(0.0, began + number / 1000 - time.time()))


if __name__ == "__main__":
    main()
