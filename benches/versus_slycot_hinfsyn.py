#!/usr/bin/env python3
"""H-infinity synthesis against slycot's sb10ad, on the same plants in the same minute, single-threaded.

Usage: OMP_NUM_THREADS=1 python3 benches/versus_slycot_hinfsyn.py [--plants N] [--calls N] [--timeout S] [--binary PATH]

Needs numpy and slycot (0.7 was measured), and the example built first:
    cargo build --release -p telepulse-design --example hinfsyn_benchmark
Prints for every plant the time of one call of both (median over calls), the ratio peer / ours, and gamma of both; the peer runs with
gtol 1e-4 and gamma0 1e4, each call in a process of its own that is stopped after the timeout.
"""

import argparse
import json
import multiprocessing
import os
import statistics
import subprocess
import tempfile
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import slycot

SEED = 5
SIZES = [5, 10, 20, 50]


def plant(rng, n):
    nw, nu, nz, ny = 3, 2, 3, 2
    a = rng.standard_normal((n, n))
    a -= (np.linalg.eigvals(a).real.max() + 0.5) * np.eye(n)
    shapes = {"B1": (n, nw), "B2": (n, nu), "C1": (nz, n), "C2": (ny, n), "D12": (nz, nu), "D21": (ny, nw)}
    problem = {key: rng.standard_normal(shape).tolist() for key, shape in shapes.items()}
    zeros = {"D11": np.zeros((nz, nw)).tolist(), "D22": np.zeros((ny, nu)).tolist()}
    return {"id": f"n={n}", "n": n, "nw": nw, "nu": nu, "nz": nz, "ny": ny, "A": a.tolist(), **problem, **zeros}


def peer(p, calls, queue):
    get = lambda key: np.array(p[key])
    b, c = np.hstack([get("B1"), get("B2")]), np.vstack([get("C1"), get("C2")])
    d = np.block([[get("D11"), get("D12")], [get("D21"), get("D22")]])
    m, np_ = b.shape[1], c.shape[0]
    seconds, gamma = [], None
    for _ in range(calls):
        start = time.perf_counter()
        try:
            gamma = float(slycot.sb10ad(p["n"], m, np_, p["nu"], p["ny"], 1e4, get("A"), b, c, d, gtol=1e-4)[0])
        except Exception as error:
            gamma = type(error).__name__
        seconds.append(time.perf_counter() - start)
    queue.put((statistics.median(seconds), gamma))


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--plants", type=int, default=3)
    parser.add_argument("--calls", type=int, default=3)
    parser.add_argument("--timeout", type=float, default=60.0)
    parser.add_argument("--binary", default="target/release/examples/hinfsyn_benchmark")
    arguments = parser.parse_args()
    rng = np.random.default_rng(SEED)
    problems = [plant(rng, n) for n in SIZES for _ in range(arguments.plants)]
    print(f"seed {SEED}, slycot {slycot.__version__}; ms per call")
    print("   n    sb10ad      ours   ratio   gamma of sb10ad, our bracket")
    for problem in problems:
        with tempfile.NamedTemporaryFile("w", suffix=".json") as file:
            json.dump({"problems": [problem]}, file)
            file.flush()
            run = subprocess.run([arguments.binary, file.name, str(3 * arguments.calls)], capture_output=True, text=True)
        ours = json.loads(run.stdout)
        queue = multiprocessing.Queue()
        process = multiprocessing.Process(target=peer, args=(problem, arguments.calls, queue))
        process.start()
        try:
            seconds, gamma = queue.get(timeout=arguments.timeout)
        except Exception:
            seconds, gamma = float("inf"), "no answer"
        process.kill()
        bracket = f"{ours.get('gamma_lower', float('nan')):.6g} .. {ours.get('gamma_upper', float('nan')):.6g}"
        ratio = seconds / ours["seconds"]
        print(f"{problem['n']:4d} {1e3 * seconds:9.2f} {1e3 * ours['seconds']:9.2f} {ratio:7.1f}   {gamma}, {bracket}", flush=True)


main()
