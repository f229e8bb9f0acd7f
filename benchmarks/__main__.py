"""`python -m benchmarks`: all of them, one after the other."""

import sys

from benchmarks import (
    bench_authentication,
    bench_campaign,
    bench_codec,
    bench_filter,
    bench_rig,
    bench_rig_live,
    bench_virtual_time,
)

if __name__ == "__main__":
    benches = (
        bench_authentication,
        bench_codec,
        bench_filter,
        bench_rig,
        bench_rig_live,
        bench_virtual_time,
        bench_campaign,
    )
    codes = [bench.main([]) for bench in benches]
    sys.exit(max(codes))
