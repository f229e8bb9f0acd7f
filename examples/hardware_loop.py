"""A skeleton of a hardware loop: what is on the bus already is used, the rest is started here.

    python examples/hardware_loop.py                                   both nodes, a local bus
    python examples/hardware_loop.py -i socketcan -c can0 --start rig  a controller on can0
    python examples/hardware_loop.py -i socketcan -c can0 --start controller   a gearbox on can0

Before a controller of yours moves a real gearbox, read docs/guard.md, and listen first
(`meshpoint controller -i ... -c ...` without --arm; `meshpoint watch -i ... -c ...`). This script
commands shifts and arms the controller that it starts. It was never tried on hardware.
"""

import argparse
import sys

import meshpoint


def main(words=None):
    """Makes the shifts; exit code 1 where one did not end in its gear."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-i", "--interface")
    parser.add_argument("-c", "--channel")
    parser.add_argument("--start", nargs="*", default=["rig", "controller"])
    parser.add_argument("--gearbox")
    parser.add_argument("--shifts", type=int, default=4)
    parser.add_argument("--log", default="hardware_loop.log")
    chosen = parser.parse_args(words)
    bad = 0
    with meshpoint.LiveBench(
        interface=chosen.interface,
        channel=chosen.channel,
        start=chosen.start,
        gearbox=chosen.gearbox,
        log=chosen.log,
    ) as bench:
        # Wait until the controller knows its gear: all channels valid, clutch closed.
        bench.run_until(lambda bench: bench.status is not None and bench.status.current_gear == 8)
        for _ in range(chosen.shifts):
            # A rig is brought back into gear 8 by its bench script. Where the gearbox is real,
            # bring it there your own way, and ask with
            # bench.send(meshpoint.messages.TC1(requested_gear=10)) instead.
            try:
                row = bench.shift(10, from_gear=8)
            except meshpoint.ShiftError as error:
                print(error, file=sys.stderr)
                bad += 1
                continue
            print(f"{row.from_} -> {row.to}: {row.result}, {row.duration_ms:.0f} ms, {row.contact}")
            bad += row.result != "engaged"
    print(f"log {chosen.log}: {meshpoint.replay(chosen.log).verdict.value}")
    return 1 if bad else 0


if __name__ == "__main__":
    raise SystemExit(main())
