"""All benchmarks, or those named, one after the other, below a line on what they run on."""

import argparse
import os
import platform
import sys
import sysconfig

from benchmarks import (
    bench_authentication,
    bench_campaign,
    bench_codec,
    bench_controller_live,
    bench_filter,
    bench_replay,
    bench_rig,
    bench_rig_live,
    bench_step,
    bench_virtual_time,
)


def interpreter() -> str:
    """Which Python this is, and whether it says that it was built with profile (PGO) and link-time
    optimisation, which alone make it a quarter to a third faster. A distributor's may be without
    saying so."""
    given = str(sysconfig.get_config_var("CONFIG_ARGS"))
    optimised = [name for name in ("enable-optimizations", "with-lto") if name in given]
    built = " and ".join(optimised) or "no word of PGO or LTO"
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    return (
        f"Python {platform.python_version()} at {sys.executable}, configured with {built}; "
        f"{os.cpu_count()} processors, load {load}"
    )


BENCHES = {
    "authentication": bench_authentication,
    "codec": bench_codec,
    "filter": bench_filter,
    "rig": bench_rig,
    "rig_live": bench_rig_live,
    "step": bench_step,
    "controller_live": bench_controller_live,
    "virtual_time": bench_virtual_time,
    "replay": bench_replay,
    "campaign": bench_campaign,
}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description=__doc__,
        epilog="Measured for longer, each by itself: python -m benchmarks.promises, .aborts, "
        ".bench_campaign_memory, .envelope, .studies, .swarm; beside a commit before: "
        ".bench_speed --against COMMIT.",
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(BENCHES)}")
    names = parser.parse_args().names
    unknown = [name for name in names if name not in BENCHES]
    if unknown:
        parser.error(f"{unknown[0]}: no such benchmark; there are {', '.join(BENCHES)}")
    print(interpreter(), flush=True)
    sys.exit(max(BENCHES[name].main([]) for name in names or BENCHES))
