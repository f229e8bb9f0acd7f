"""A process of the log tests: writes frames to the log FILE, 500 a second, until it is killed."""

import itertools
import sys
import time

from bus.recorder import LogWriter
from dbc.frame import Frame


def main() -> None:
    log = LogWriter(sys.argv[1])
    began = time.time()
    for number in itertools.count():
        log.write(time.time(), Frame(0x18FF0001, number.to_bytes(4, "big") + bytes(44)))
        if number == 10:
            print("ready", flush=True)
        time.sleep(max(0.0, began + number / 500 - time.time()))


if __name__ == "__main__":
    main()
