"""Reduced systems and norms by slycot (SLICOT ab09ad, ab09bd, ab09cd, ab13ad, ab13bd) for reduce_oracle.json.

Run with Python 3, numpy and slycot 0.7:  python reduce_oracle.py > reduce_oracle.json
"""
import json

import numpy as np
import slycot

OMEGA = [0.01, 0.3, 2.0, 11.0]


def system(rng, n, m, p, discrete):
    a = rng.uniform(-1, 1, (n, n))
    if discrete:
        a *= 0.9 / max(abs(np.linalg.eigvals(a)))
    else:
        a = np.diag(10.0 ** (1.5 * np.arange(n) / n)) @ a
        a -= (max(np.linalg.eigvals(a).real) + 0.2) * np.eye(n)
    return a, rng.uniform(-1, 1, (n, m)), rng.uniform(-1, 1, (p, n)), rng.uniform(-1, 1, (p, m))


def response(a, b, c, d, dt):
    """Rows of (re, im), column by column of each matrix."""
    out = []
    for w in OMEGA:
        point = np.exp(1j * w * dt) if dt else 1j * w
        g = c @ np.linalg.solve(point * np.eye(len(a)) - a, b) + d
        out.append([[v.real, v.imag] for v in g.flatten(order="F")])
    return out


def main():
    rng = np.random.default_rng(20251125)
    cases = []
    for k in range(12):
        dt = 0.1 if k % 2 else None
        n, m, p = 3 + k % 5, 1 + k % 3, 1 + k % 2
        a, b, c, d = system(rng, n, m, p, bool(dt))
        dico, order = ("D" if dt else "C"), n // 2
        args = (dico, "B", "N", n, m, p)
        f = lambda x: np.array(x, order="F")
        _, ar, br, cr, hsv = slycot.ab09ad(*args, f(a), f(b), f(c), nr=order, tol=0.0)
        truncated = response(ar, br, cr, d, dt)
        _, ar, br, cr, dr, _ = slycot.ab09bd(*args, f(a), f(b), f(c), f(d), nr=order, tol1=0.0, tol2=0.0)
        residualized = response(ar, br, cr, dr, dt)
        d_h2 = d if dt else np.zeros_like(d)
        h2 = slycot.ab13bd(dico, "H", n, m, p, f(a), f(b), f(c), f(d_h2))
        cases.append(
            {
                "dt": dt, "a": a.tolist(), "b": b.tolist(), "c": c.tolist(), "d": d.tolist(), "order": order,
                "hankel_singular_values": list(hsv), "truncated": truncated, "residualized": residualized,
                "h2_without_continuous_d": float(h2[0] if isinstance(h2, tuple) else h2),
            }
        )
    print(json.dumps({"made_by": f"reduce_oracle.py, slycot {slycot.__version__}", "omega_rad_s": OMEGA, "cases": cases}))


main()
