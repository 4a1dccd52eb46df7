"""Ratios of the solvers' times to those of scipy and slycot, for random problems of the same kind and size.

Run `cargo bench -p telepulse-lti` first, then in the same minute `python benches/versus_slycot_equations.py`. It reads the
medians that the bench left under target/criterion and times the peer for as long. One thread: OPENBLAS_NUM_THREADS is set.
"""
import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import json
import pathlib
import time

import numpy as np
import scipy.linalg as la
import slycot

ROOT = pathlib.Path(__file__).parent.parent / "target" / "criterion"


def median_seconds(solve):
    solve()
    times, start = [], time.perf_counter()
    while time.perf_counter() - start < 0.3 or len(times) < 5:
        before = time.perf_counter()
        solve()
        times.append(time.perf_counter() - before)
    return np.median(times)


def peers(n):
    rng = np.random.default_rng(n)
    a = rng.uniform(-1, 1, (n, n)) * np.sqrt(3 / n)
    b, c = rng.uniform(-1, 1, (n, 2)), rng.uniform(-1, 1, (2, n))
    g, q, stable = b @ b.T, c.T @ c, a - 1.5 * np.eye(n)
    return {
        "eigenvalues": ("scipy eigvals", lambda: la.eigvals(a)),
        "schur": ("scipy schur", lambda: la.schur(a)),
        "ordered_schur": ("scipy schur, sorted", lambda: la.schur(a, sort="lhp")),
        "lyapunov_continuous": ("slycot sb03md", lambda: slycot.sb03md57(stable.copy(), C=-q, dico="C")),
        "lyapunov_discrete": ("slycot sb03md", lambda: slycot.sb03md57(a.copy(), C=-q, dico="D")),
        "sylvester_continuous": ("slycot sb04md", lambda: slycot.sb04md(n, n, stable.copy(), stable.copy(), -q)),
        "sylvester_discrete": ("slycot sb04qd", lambda: slycot.sb04qd(n, n, a.copy(), stable.copy(), -q)),
        "care": ("slycot sb02md", lambda: slycot.sb02md(n, stable.copy(), g.copy(), q.copy(), "C")),
        "dare": ("slycot sb02md", lambda: slycot.sb02md(n, 0.5 * a, g.copy(), q.copy(), "D")),
        "hinf_norm": ("slycot ab13dd", lambda: slycot.ab13dd("C", "I", "S", "Z", n, 2, 2, stable, np.eye(n), b, c,
                                                               np.zeros((2, 2)))),
    }


for n in [5, 10, 20, 50, 100]:
    for name, (peer, solve) in peers(n).items():
        estimates = ROOT / name / str(n) / "new" / "estimates.json"
        if not estimates.exists():
            continue
        own = json.loads(estimates.read_text())["median"]["point_estimate"] * 1e-9
        try:
            theirs = median_seconds(solve)
        except slycot.exceptions.SlycotError as error:
            print(f"{name:22s} n {n:4d}  {own * 1e6:10.1f} us   {peer:26s} fails: {' '.join(str(error).split())}")
            continue
        print(f"{name:22s} n {n:4d}  {own * 1e6:10.1f} us   {peer:26s} {theirs * 1e6:10.1f} us   ratio {theirs / own:6.2f}")
