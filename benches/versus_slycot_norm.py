#!/usr/bin/env python3
"""H-infinity norms against slycot's ab13dd, on the same systems in the same minute, single-threaded.

Usage: OMP_NUM_THREADS=1 python3 benches/versus_slycot_norm.py [--systems N] [--seconds S] [--binary PATH]

Needs numpy and slycot (0.7 was measured), and the example built first:
    cargo build --release -p telepulse-lti --example norm_benchmark
Prints, for every size and number of ports, the median time per call of both and the median over systems of the ratio
peer / ours, and stops with exit code 1 where the two norms differ by more than 1e-6 or ours is the lower one by 1e-9.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import slycot

SEED = 2024
SIZES = [5, 10, 20, 50, 100]
PORTS = [(1, 1), (2, 2), (3, 3)]


def random_stable(rng, n, m, p, kind):
    """A dense system shifted to stability, or a flexible one in mixed coordinates."""
    if kind == "dense":
        a = rng.standard_normal((n, n))
        a -= np.eye(n) * (np.linalg.eigvals(a).real.max() + 0.1)
    else:
        a = np.zeros((n, n))
        for i in range(0, n - 1, 2):
            w, zeta = 10 ** rng.uniform(-1, 2), 10 ** rng.uniform(-3, -1)
            a[i : i + 2, i : i + 2] = [[0, w], [-w, -2 * zeta * w]]
        if n % 2:
            a[-1, -1] = -1
        q, _ = np.linalg.qr(rng.standard_normal((n, n)))
        a = q @ a @ q.T
    return a, rng.standard_normal((n, m)), rng.standard_normal((p, n)), rng.standard_normal((p, m))


def peer(a, b, c, d):
    n, m, p = a.shape[0], b.shape[1], c.shape[0]
    return slycot.ab13dd("C", "I", "S", "D", n, m, p, a, np.eye(n), b, c, d, tol=1e-9)[0]


def median_seconds(call, budget):
    times, calls, start = [], 1, time.perf_counter()
    while time.perf_counter() - start < budget:
        t = time.perf_counter()
        for _ in range(calls):
            call()
        t = time.perf_counter() - t
        times.append(t / calls)
        if t < budget / 50:
            calls *= 2
    return float(np.median(times))


def main():
    root = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--systems", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=0.1, help="per system and side")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--binary", default=os.path.join(root, "target/release/examples/norm_benchmark"))
    options = parser.parse_args()
    rng, failed = np.random.default_rng(SEED), False
    print(f"seed {SEED}, slycot {slycot.__version__}; microseconds per call, medians of {options.systems} systems")
    print(f"{'n':>4} {'m':>2} {'p':>2} {'kind':>9} {'ab13dd':>10} {'ours':>10} {'ratio':>7}")
    for n in options.sizes:
        for m, p in PORTS:
            for kind in ("dense", "flexible"):
                ours, theirs, ratios = [], [], []
                for _ in range(options.systems):
                    a, b, c, d = random_stable(rng, n, m, p, kind)
                    with tempfile.NamedTemporaryFile("w", suffix=".json") as f:
                        json.dump([dict(A=a.tolist(), B=b.tolist(), C=c.tolist(), D=d.tolist())], f)
                        f.flush()
                        line = subprocess.check_output([options.binary, f.name, str(options.seconds)], text=True)
                    answer = json.loads(line)
                    reference = peer(a, b, c, d)
                    seconds = median_seconds(lambda: peer(a, b, c, d), options.seconds)
                    if not -1e-9 < answer["value"] / reference - 1 < 1e-6:
                        print(f"differs: n {n} {kind}: ours {answer['value']!r}, ab13dd {reference!r}")
                        failed = True
                    ours.append(answer["seconds"])
                    theirs.append(seconds)
                    ratios.append(seconds / answer["seconds"])
                print(
                    f"{n:4} {m:2} {p:2} {kind:>9} {1e6 * np.median(theirs):10.1f} {1e6 * np.median(ours):10.1f}"
                    f" {np.median(ratios):7.2f}"
                )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
