"""A process of the log tests: writes frames to the log FILE, 1000 a second, until it is killed.

With a SIZE it writes parts of that many bytes."""

import itertools
import os
import sys
import time
from pathlib import Path

from meshpoint.bus.logs.files import RotatingLog
from meshpoint.bus.logs.recorder import LogWriter
from meshpoint.dbc.frame import Frame


def main() -> None:
    path = Path(sys.argv[1])
    size = int(sys.argv[2]) if len(sys.argv) > 2 else None
    log = LogWriter(path) if size is None else RotatingLog(path, size, channel="vcan0")
    began = time.time()
    for number in itertools.count():
        log.write(time.time(), Frame(0x18FF0001, number.to_bytes(4, "big") + os.urandom(44)))
        if number == 10:
            print("ready", flush=True)
        time.sleep(max(0.0, began + number / 1000 - time.time()))


if __name__ == "__main__":
    main()
