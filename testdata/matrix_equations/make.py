"""Writes riccati.json and linear.json: small matrix equations and their solutions to fifty digits, rounded once.

Usage: python make.py   (needs numpy, scipy and mpmath; the versions used are stored in the files)

The Riccati problems have the traits of the CAREX and DAREX collections (Benner, Laub, Mehrmann 1995): a double integrator,
nearly unreachable and nearly unobservable modes, nearly singular and singular R, singular perturbation, cross terms,
indefinite Q and R, states in very different units. scipy gives the start of a Newton iteration in mpmath; every step solves
its linear equation as a Kronecker system, so nothing is shared with Schur methods. `scipy_error` is the relative error of
scipy's own answer.
"""
import json
import pathlib

import mpmath as mp
import numpy as np
import scipy
import scipy.linalg as la

mp.mp.dps = 50
HERE = pathlib.Path(__file__).parent
rng = np.random.default_rng(2026)


def m(x):
    x = np.atleast_2d(np.asarray(x, float))
    return mp.matrix(x.tolist())


def to_float(x):
    return [[float(x[i, j]) for j in range(x.cols)] for i in range(x.rows)]


def kron_solve(operator, rows, cols, right):
    """Solves operator(X) = right, the operator given by its action on unit matrices."""
    size = rows * cols
    system, rhs = mp.matrix(size, size), mp.matrix(size, 1)
    for j in range(cols):
        for i in range(rows):
            unit = mp.matrix(rows, cols)
            unit[i, j] = 1
            image = operator(unit)
            for k in range(size):
                system[k, i + rows * j] = image[k % rows, k // rows]
            rhs[i + rows * j] = right[i, j]
    x = mp.lu_solve(system, rhs)
    return mp.matrix([[x[i + rows * j] for j in range(cols)] for i in range(rows)])


def riccati(name, kind, A, B, Q, R, S=None, start=None):
    A, B, Q, R = (np.atleast_2d(np.asarray(v, float)) for v in (A, B, Q, R))
    S = np.zeros(B.shape) if S is None else np.asarray(S, float)
    scipy_x = None
    try:
        solve = la.solve_continuous_are if kind == "care" else la.solve_discrete_are
        scipy_x = solve(A, B, Q, R, s=S)
    except Exception:
        pass
    x = m(start if start is not None else scipy_x)
    a, b, q, r, s = m(A), m(B), m(Q), m(R), m(S)
    for step in range(60):
        if kind == "care":
            k = mp.inverse(r) * (b.T * x + s.T)
            c = a - b * k
            left = a.T * x + x * a - k.T * r * k + q
            change = kron_solve(lambda u: c.T * u + u * c, x.rows, x.cols, -left)
        else:
            w = r + b.T * x * b
            k = mp.inverse(w) * (b.T * x * a + s.T)
            c = a - b * k
            left = a.T * x * a - x - k.T * w * k + q
            change = kron_solve(lambda u: c.T * u * c - u, x.rows, x.cols, -left)
        x = x + change
        if mp.mnorm(change, "f") < mp.mpf(10) ** -35 * mp.mnorm(x, "f"):
            break
    else:
        raise RuntimeError(f"{name}: no convergence")
    poles = [complex(v) for v in mp.eig(c, left=False, right=False)]
    assert all(p.real < 0 if kind == "care" else abs(p) < 1 for p in poles), (name, poles)
    exact = np.array(to_float(x))
    error = None if scipy_x is None else float(la.norm(scipy_x - exact) / la.norm(exact))
    return dict(name=name, kind=kind, A=A.tolist(), B=B.tolist(), Q=Q.tolist(), R=R.tolist(), S=S.tolist(),
                X=to_float(x), poles=[[p.real, p.imag] for p in poles], scipy_error=error)


def riccati_collection():
    v = np.eye(3) - 2 / 3 * np.ones((3, 3))
    out = [
        riccati("double integrator", "care", [[0, 1], [0, 0]], [[0], [1]], np.diag([1, 2]), 1),
        riccati("unstable, rank-one Q", "care", [[4, 3], [-4.5, -3.5]], [[1], [-1]], [[9, 6], [6, 4]], 1),
    ]
    for e in [1e-2, 1e-6]:
        out.append(riccati(f"nearly unreachable {e:g}", "care", [[1, 0], [0, -2]], [[e], [0]], np.ones((2, 2)), 1,
                           start=[[2.0 / e**2, 0], [0, 0.25]]))
    for e in [1e-4, 1e-8]:
        out.append(riccati(f"nearly singular R {e:g}", "care", np.diag([-0.1, -0.02]), [[0.1, 0], [0.001, 0.01]],
                           [[100, 1000], [1000, 10000]], [[1 + e, 1], [1, 1]]))
    for e in [1.0, 1e-3, 1e3, 1e6]:
        out.append(riccati(f"weakly coupled {e:g}", "care", [[0, e], [0, 0]], [[0], [1]], np.eye(2), 1))
    for e in [1e-2, 1e-5]:
        A = v @ np.diag([e, 2 * e, 3 * e]) @ v
        G = v @ np.diag([1 / e, 1 / e, 1 / e]) @ v
        Q = v @ np.diag([1 / e, 1, e]) @ v
        out.append(riccati(f"large G, graded Q {e:g}", "care", A, np.eye(3), (Q + Q.T) / 2, la.inv((G + G.T) / 2)))
    for e in [1e-2, 1e-6]:
        A = [[0, 0.4, 0, 0], [0, 0, 0.345, 0], [0, -0.524 / e, -0.465 / e, 0.262 / e], [0, 0, 0, -1 / e]]
        out.append(riccati(f"singular perturbation {e:g}", "care", A, [[0], [0], [0], [1 / e]],
                           np.diag([1, 0, 1, 0]), 1))
    n = 5
    shift = np.diag(np.ones(n - 1), 1)
    out.append(riccati("chain of integrators", "care", shift, np.eye(n)[:, [n - 1]], np.eye(n), 1))
    out.append(riccati("chain of integrators, cheap control", "care", shift, np.eye(n)[:, [n - 1]], np.eye(n), 1e-8))
    for gamma in [10.0, 2.5]:
        out.append(riccati(f"game, gamma {gamma:g}", "care", [[0, 1], [-1, -0.2]], [[0.5, 0], [0, 1]], np.eye(2),
                           np.diag([-gamma**2, 1])))
    out.append(riccati("indefinite Q with cross term", "care", [[-1, 2], [0, -3]], [[1], [2]], [[1, 0], [0, -0.2]], 2,
                       [[0.5], [0.3]]))
    w = rng.standard_normal((6, 6))
    w = w @ w.T
    A, B = rng.standard_normal((4, 4)), rng.standard_normal((4, 2))
    out.append(riccati("random with cross term", "care", A, B, w[:4, :4], w[4:, 4:], w[:4, 4:]))
    t = 10.0 ** np.array([-6, 3, 0, 5])
    units = (A * t[None, :] / t[:, None], B / t[:, None], w[:4, :4] * np.outer(t, t), w[4:, 4:], w[:4, 4:] * t[:, None])
    base = np.array(out[-1]["X"]) * np.outer(t, t)
    out.append(riccati("the same in units that differ by 1e11", "care", *units, start=base))

    out += [
        riccati("unstable, rank-one Q", "dare", [[4, 3], [-4.5, -3.5]], [[1], [-1]], [[9, 6], [6, 4]], 1),
        riccati("two inputs", "dare", np.diag([0.9512, 0.9048]), [[4.877, 4.877], [-1.1895, 3.569]],
                np.diag([0.005, 0.02]), np.diag([1 / 3, 3])),
        riccati("R zero", "dare", [[2, -1], [1, 0]], [[1], [0]], np.diag([0, 1]), 0, start=np.eye(2)),
        riccati("singular R, cross term", "dare", [[0, 1], [0, -1]], [[1, 0], [2, 1]],
                [[-4 / 11, -4 / 11], [-4 / 11, 7 / 11]], [[9, 3], [3, 1]], [[3, 1], [-1, 7]]),
        riccati("cheap control", "dare", [[4, 3], [-4.5, -3.5]], [[1], [-1]], [[9, 6], [6, 4]], 1e-6),
        riccati("costly control", "dare", [[4, 3], [-4.5, -3.5]], [[1], [-1]], [[9, 6], [6, 4]], 1e6),
    ]
    for e in [1.0, 1e3, 1e6]:
        out.append(riccati(f"delay with gain {e:g}", "dare", [[0, e], [0, 0]], [[0], [1]], np.eye(2), 1,
                           start=np.diag([1, 1 + e * e])))
    n = 6
    shift = np.diag(np.ones(n - 1), 1)
    out.append(riccati("shift register", "dare", shift, np.eye(n)[:, [n - 1]], np.eye(n), 1,
                       start=np.diag(np.arange(1.0, n + 1))))
    w = rng.standard_normal((6, 6))
    w = w @ w.T
    A, B = rng.standard_normal((4, 4)), rng.standard_normal((4, 2))
    out.append(riccati("random with cross term", "dare", A, B, w[:4, :4], w[4:, 4:], w[:4, 4:]))
    base = np.array(out[-1]["X"]) * np.outer(t, t)
    units = (A * t[None, :] / t[:, None], B / t[:, None], w[:4, :4] * np.outer(t, t), w[4:, 4:], w[:4, 4:] * t[:, None])
    out.append(riccati("the same in units that differ by 1e11", "dare", *units, start=base))
    out.append(riccati("game", "dare", [[1, 0.1], [-0.1, 0.98]], [[0.05, 0], [0, 0.1]], np.eye(2) * 0.1,
                       np.diag([-25.0, 1])))
    return out


def linear(name, kind, A, B, C):
    """A X + X B + C = 0, or A X B - X + C = 0."""
    a, b, c = m(A), m(B), m(C)
    if kind == "continuous":
        x = kron_solve(lambda u: a * u + u * b, c.rows, c.cols, -c)
    else:
        x = kron_solve(lambda u: a * u * b - u, c.rows, c.cols, -c)
    return dict(name=name, kind=kind, A=np.asarray(A).tolist(), B=np.asarray(B).tolist(), C=np.asarray(C).tolist(),
                X=to_float(x))


def linear_collection():
    out = []
    for kind in ["continuous", "discrete"]:
        for n, k in [(1, 1), (2, 3), (5, 4)]:
            A, B, C = rng.standard_normal((n, n)), rng.standard_normal((k, k)), rng.standard_normal((n, k))
            out.append(linear(f"random {n} {k}", kind, A, B, C))
        A, B, C = rng.standard_normal((4, 4)), rng.standard_normal((3, 3)), rng.standard_normal((4, 3))
        d, e = 10.0 ** np.array([-5, 0, 4, 6]), 10.0 ** np.array([3, -4, 0])
        out.append(linear("units that differ by 1e11", kind, A * d[None, :] / d[:, None], B * e[None, :] / e[:, None],
                          C * e[None, :] / d[:, None]))
        q = rng.standard_normal((4, 4))
        q = q + q.T
        stable = np.diag([-1e-3, -1, -1e3, -2.0]) + np.triu(rng.standard_normal((4, 4)), 1)
        if kind == "discrete":
            stable = np.diag([0.999, 0.5, -0.9, 0.0]) + np.triu(rng.standard_normal((4, 4)), 1)
        out.append(linear("stiff gramian", kind, stable, stable.T, q))
        for gap in [1e-4, 1e-8]:
            u = la.qr(rng.standard_normal((3, 3)))[0]
            A = u @ np.diag([1.0, 2.0, -3.0]) @ u.T
            B = np.diag([-1.0 - gap, 4.0]) if kind == "continuous" else np.diag([1.0 - gap, 4.0])
            out.append(linear(f"nearly singular {gap:g}", kind, A, B, rng.standard_normal((3, 2))))
        jordan = (-0.5 * np.eye(5) + np.diag(np.ones(4), 1))
        out.append(linear("one jordan block", kind, jordan, jordan.T, np.eye(5)))
    return out


versions = dict(numpy=np.__version__, scipy=scipy.__version__, mpmath=mp.__version__, digits=mp.mp.dps)
for file, problems in [("riccati.json", riccati_collection()), ("linear.json", linear_collection())]:
    text = ",\n".join(json.dumps(p) for p in problems)
    (HERE / file).write_text(f'{{"made_by": "make.py", "versions": {json.dumps(versions)}, "problems": [\n{text}\n]}}\n')
    for p in problems:
        print(p["name"], p["kind"], p.get("scipy_error"))
