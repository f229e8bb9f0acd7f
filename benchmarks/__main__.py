"""`python -m benchmarks`: all of them, one after the other, below a line on what they run on."""

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


if __name__ == "__main__":
    print(interpreter(), flush=True)
    benches = (
        bench_authentication,
        bench_codec,
        bench_filter,
        bench_rig,
        bench_rig_live,
        bench_step,
        bench_controller_live,
        bench_virtual_time,
        bench_replay,
        bench_campaign,
    )
    codes = [bench.main([]) for bench in benches]
    sys.exit(max(codes))
