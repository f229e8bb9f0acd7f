"""`python -m benchmarks`: all of them, one after the other."""

import sys

from benchmarks import bench_codec, bench_filter, bench_rig, bench_virtual_time

if __name__ == "__main__":
    codes = [bench.main([]) for bench in (bench_codec, bench_filter, bench_rig, bench_virtual_time)]
    sys.exit(max(codes))
