#!/usr/bin/env python3
"""Static membrane solves against a Python Chebyshev collocation and scipy's solve_bvp, in the same minute, one thread.

Usage: OMP_NUM_THREADS=1 python3 benches/versus_python_membrane.py [--binary PATH]

Needs numpy and scipy, and the example built first:
    cargo build --release -p telepulse-actuator --example static_benchmark
All solve set A's membrane under its weight of 0.980665 N. Prints median times and ratios, and stops with exit code 1 where a
displacement differs by more than 1e-8 relative (1e-5 for solve_bvp at its tolerance of 1e-6).
"""

import argparse
import json
import os
import subprocess
import sys
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import scipy
from scipy.integrate import solve_bvp

MU, J, EPS = 37220.0, 110.0, 5.8 * 8.8541878128e-12
A, B, H, LP = 0.0127 / 2, 0.06858 / 2, 1e-3, 2.0
FORCE = 0.980665
F = FORCE / (2 * np.pi * MU * H * B)


def stress(l1, l2, field):
    """s1, s2 and their derivatives s11, s12, s22 over mu."""
    l3sq = 1 / (l1 * l2) ** 2
    n1, n2 = l1 - l3sq / l1, l2 - l3sq / l2
    g = J / (J - (l1**2 + l2**2 + l3sq - 3))
    dg = 2 * g * g / J
    s11 = g * (1 + 3 * l3sq / l1**2) + dg * n1 * n1 - field * l2**2
    s12 = g * 2 * l3sq / (l1 * l2) + dg * n1 * n2 - 2 * field * l1 * l2
    s22 = g * (1 + 3 * l3sq / l2**2) + dg * n2 * n2 - field * l1**2
    return g * n1 - field * l1 * l2**2, g * n2 - field * l1**2 * l2, s11, s12, s22


def field_of(volts):
    return (volts / H) ** 2 * EPS / MU


class Chebyshev:
    """Collocation in (r, z) in linear R, Newton with the full analytic Jacobian."""

    def __init__(self, n):
        k = np.arange(n + 1)
        x = -np.cos(np.pi * k / n)
        c = np.where((k == 0) | (k == n), 2.0, 1.0) * (-1.0) ** k
        d = np.outer(c, 1 / c) / (x[:, None] - x[None, :] + np.eye(n + 1))
        d -= np.diag(d.sum(axis=1))
        half = (1 - A / B) / 2
        self.n, self.d = n, d / half
        self.rho = (1 + A / B) / 2 + half * x

    def guess(self):
        z = 0.2 * np.log(self.rho) / np.log(A / B)
        return LP * self.rho, z

    def solve(self, r, z, field):
        n, d, rho = self.n, self.d, self.rho
        r, z = r.copy(), z.copy()
        for _ in range(30):
            p, q = d @ r, d @ z
            l1, l2 = np.hypot(p, q), r / rho
            s1, s2, s11, s12, s22 = stress(l1, l2, field)
            c, e, geo = p / l1, q / l1, s1 / l1
            radial, vertical = rho * s1 * c, rho * s1 * e
            res = np.concatenate([(d @ radial - s2)[1:n], (d @ vertical)[1:n], [-(vertical[0] + vertical[1]) / 2 - F]])
            pp = rho * (s11 * c * c + geo * e * e)
            pq = rho * (s11 - geo) * c * e
            qq = rho * (s11 * e * e + geo * c * c)
            dpr, dpz = pp[:, None] * d + np.diag(s12 * c), pq[:, None] * d
            dqr, dqz = pq[:, None] * d + np.diag(s12 * e), qq[:, None] * d
            dsr, dsz = (s12 * c)[:, None] * d + np.diag(s22 / rho), (s12 * e)[:, None] * d
            inner = d[1:n]
            jac = np.empty((2 * n - 1, 2 * n - 1))
            jac[: n - 1, : n - 1] = (inner @ dpr - dsr[1:n])[:, 1:n]
            jac[: n - 1, n - 1 :] = (inner @ dpz - dsz[1:n])[:, :n]
            jac[n - 1 : -1, : n - 1] = (inner @ dqr)[:, 1:n]
            jac[n - 1 : -1, n - 1 :] = (inner @ dqz)[:, :n]
            jac[-1, : n - 1] = -(dqr[0] + dqr[1])[1:n] / 2
            jac[-1, n - 1 :] = -(dqz[0] + dqz[1])[:n] / 2
            step = np.linalg.solve(jac, -res)
            r[1:n] += step[: n - 1]
            z[:n] += step[n - 1 :]
            if np.abs(step).max() < 1e-9:
                return r, z
        raise RuntimeError("no convergence")


def bvp(volts, tol):
    """solve_bvp in r, z, theta, l1 from the flat state."""
    field = field_of(volts)

    def rates(rho, y):
        r, _, theta, l1 = y
        l2 = r / rho
        s1, s2, s11, s12, _ = stress(l1, l2, field)
        dr = l1 * np.cos(theta)
        dl2 = (dr - l2) / rho
        # d(R s1 cos)/dR = s2 and d(R s1 sin)/dR = 0.
        ds1 = (s2 * np.cos(theta) - s1) / rho
        return np.array([dr, -l1 * np.sin(theta), -s2 * np.sin(theta) / (rho * s1), (ds1 - s12 * dl2) / s11])

    def ends(ya, yb):
        s1 = stress(ya[3], ya[0] / (A / B), field)[0]
        return np.array([ya[0] - LP * A / B, yb[0] - LP, yb[1], (A / B) * s1 * np.sin(ya[2]) - F])

    rho = np.linspace(A / B, 1, 12)
    y = np.array([LP * rho, 0.2 * np.log(rho) / np.log(A / B), np.full_like(rho, 0.1), np.full_like(rho, LP)])
    return solve_bvp(rates, ends, rho, y, tol=tol)


def median(call, budget=2.0):
    times, start = [], time.perf_counter()
    while time.perf_counter() - start < budget:
        t = time.perf_counter()
        call()
        times.append(time.perf_counter() - t)
    return 1e6 * float(np.median(times))


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--binary", default="target/release/examples/static_benchmark")
    ours = [json.loads(line) for line in subprocess.check_output([parser.parse_args().binary], text=True).splitlines()]
    print(f"numpy {np.__version__}, scipy {scipy.__version__}; medians in us, in brackets times ours")
    right = True
    for row in ours:
        n = row["degree"]
        solver = Chebyshev(n)
        known = solver.solve(*solver.guess(), field_of(2490.0))
        x = solver.solve(*known, field_of(2500.0))[1][0] * B
        warm = median(lambda: solver.solve(*known, field_of(2500.0)))
        cold = median(lambda: (lambda s: s.solve(*s.guess(), field_of(2500.0)))(Chebyshev(n)))
        error = abs(x / row["displacement_m"] - 1)
        # Linear R at degree 16 resolves to 5e-8, at 24 to 1e-10.
        right &= error < (1e-6 if n < 24 else 1e-8)
        print(
            f"degree {n}: ours warm {row['warm_force_us']:.1f}, cold {row['cold_us']:.1f}; Python Chebyshev warm {warm:.0f} "
            f"({warm / row['warm_force_us']:.1f}), cold {cold:.0f} ({cold / row['cold_us']:.1f}); differ by {error:.1e}"
        )
    for tol in [1e-6, 1e-9]:
        found = bvp(2500.0, tol)
        error = abs(found.y[1, 0] * B / ours[-1]["displacement_m"] - 1)
        right &= bool(found.success) and error < 10 * tol
        t = median(lambda: bvp(2500.0, tol))
        print(f"solve_bvp at {tol:g}: {t:.0f} ({t / ours[-1]['cold_us']:.0f} x degree 24 cold); differ by {error:.1e}")
    sys.exit(0 if right else 1)


if __name__ == "__main__":
    main()
