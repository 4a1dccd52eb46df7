"""Makes `solve_stress.json`: random H-infinity synthesis problems of the classes on which solvers fail.

    python3 make_stress.py > solve_stress.json          (numpy 2.4)
    python3 reference_gamma.py solve_stress.json        (python-flint 0.9; adds `gamma_ref`)

Everything follows from one seed. Numbers are rounded to six significant digits here, once, so that the file is the
problem: what it was rounded from plays no part. Classes whose point is an exact property (a rank, a zero on the axis)
get it by construction from zeros and equal columns, which rounding keeps.
"""

import json
import sys

import numpy as np

SEED = 20261128
PER_CLASS = 9


def dims(rng, n_max):
    """States and ports; nz >= nu and nw >= ny, so that the problem can be regular."""
    n, nu, ny = int(rng.integers(1, n_max + 1)), int(rng.integers(1, 4)), int(rng.integers(1, 4))
    return n, ny + int(rng.integers(0, 4)), nu, nu + int(rng.integers(0, 4)), ny


def problem(rng, n, nw, nu, nz, ny):
    """Normally distributed matrices; D11 and D22 zero."""
    normal = rng.standard_normal
    return {
        "A": normal((n, n)), "B1": normal((n, nw)), "B2": normal((n, nu)), "C1": normal((nz, n)), "C2": normal((ny, n)),
        "D11": np.zeros((nz, nw)), "D12": normal((nz, nu)), "D21": normal((ny, nw)), "D22": np.zeros((ny, nu)),
    }


def abscissa(a):
    return np.linalg.eigvals(a).real.max()


def stable(rng):
    p = problem(rng, *dims(rng, 15))
    p["A"] -= (abscissa(p["A"]) + rng.uniform(0.05, 1.0)) * np.eye(len(p["A"]))
    return p


def unstable(rng):
    p = problem(rng, *dims(rng, 10))
    p["A"] += (rng.uniform(0.1, 2.0) - abscissa(p["A"])) * np.eye(len(p["A"]))
    return p


def flexible(rng):
    """Modes over three decades with damping from 1e-5 to 1e-2; forces act on velocities, the first output sees positions."""
    n_modes = int(rng.integers(1, 11))
    _, nw, nu, nz, ny = dims(rng, 1)
    p = problem(rng, 2 * n_modes, nw, nu, nz, ny)
    p["A"][:] = 0.0
    for k in range(n_modes):
        omega, zeta = 10 ** rng.uniform(-1, 2), 10 ** rng.uniform(-5, -2)
        p["A"][2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0, omega], [-omega, -2 * zeta * omega]]
    p["B1"][::2], p["B2"][::2] = 0.0, 0.0
    p["C1"] *= 0.2
    p["C2"] *= 0.2
    return p


def stiff(rng):
    """Time constants over eight decades, mixed by a random rotation in half of the problems."""
    n, *ports = dims(rng, 12)
    p = problem(rng, max(n, 2), *ports)
    rates = 10 ** rng.uniform(-4, 4, len(p["A"]))
    rates[0], rates[-1] = 1e-4, 1e4
    signs = np.where(rng.random(len(rates)) < 0.2, 1.0, -1.0)
    p["A"] = np.diag(signs * rates)
    p["B1"] *= np.sqrt(rates)[:, None]
    p["B2"] *= np.sqrt(rates)[:, None]
    p["C1"] *= np.sqrt(rates)
    p["C2"] *= np.sqrt(rates)
    if rng.random() < 0.5:
        # Digits beyond the sixth matter in a mixed basis, so only a pair of fast states is mixed.
        p["A"][-1, -2] = 0.5 * rates[-1]
    return p


def scaled(rng):
    """States, inputs and outputs in units that differ by up to twelve decades; w and z keep theirs."""
    p = unstable(rng) if rng.random() < 0.5 else stable(rng)
    t = 10 ** rng.uniform(-6, 6, len(p["A"]))
    su, sy = 10 ** rng.uniform(-6, 6, p["B2"].shape[1]), 10 ** rng.uniform(-6, 6, p["C2"].shape[0])
    p["A"] = t[:, None] * p["A"] / t
    for key in ("B1", "B2"):
        p[key] = t[:, None] * p[key]
    for key in ("C1", "C2"):
        p[key] = p[key] / t
    p["B2"], p["D12"] = p["B2"] * su, p["D12"] * su
    p["C2"], p["D21"] = sy[:, None] * p["C2"], sy[:, None] * p["D21"]
    return p


def large_d11(rng):
    p = unstable(rng) if rng.random() < 0.5 else stable(rng)
    p["D11"] = rng.standard_normal(p["D11"].shape) * 10 ** rng.uniform(0, 4)
    return p


def with_d22(rng):
    p = unstable(rng) if rng.random() < 0.5 else stable(rng)
    p["D22"] = rng.standard_normal(p["D22"].shape) * 10 ** rng.uniform(-1, 3)
    p["D11"] = rng.standard_normal(p["D11"].shape)
    return p


def nearly_singular(rng):
    """The last direction of D12, of D21 or of both counts 1e-2 to 1e-6 of the others."""
    p = unstable(rng) if rng.random() < 0.3 else stable(rng)
    which = rng.integers(3)
    if which != 1:
        p["D12"][:, -1] *= 10 ** rng.uniform(-6, -2)
    if which != 0:
        p["D21"][-1] *= 10 ** rng.uniform(-6, -2)
    return p


def singular(rng):
    """D12 or D21 without full rank: a zero column, two equal ones, or nothing at all."""
    n, nw, nu, nz, ny = dims(rng, 8)
    p = problem(rng, n, nw, nu, nz, ny)
    p["A"] -= (abscissa(p["A"]) + rng.uniform(-0.5, 1.0)) * np.eye(n)
    how = rng.integers(4)
    if how == 0:
        p["D12"][:] = 0.0
    elif how == 1:
        p["D21"][:] = 0.0
    elif how == 2:
        p["D12"][:, -1] = p["D12"][:, 0] if nu > 1 else 0.0
        p["D21"][-1] = p["D21"][0] if ny > 1 else 0.0
    else:
        p["D12"][:], p["D21"][:] = 0.0, 0.0
    return p


def axis_zeros(rng):
    """An undamped mode that z does not see, or that w does not reach: a zero of that path on the axis."""
    p = stable(rng)
    omega = 0.0 if rng.random() < 0.3 else float(rng.uniform(0.2, 20.0))
    n, size = len(p["A"]), 1 if omega == 0.0 else 2
    mode = np.zeros((1, 1)) if omega == 0.0 else np.array([[0.0, omega], [-omega, 0.0]])
    q = problem(rng, size, p["B1"].shape[1], p["B2"].shape[1], p["C1"].shape[0], p["C2"].shape[0])
    p["A"] = np.block([[p["A"], np.zeros((n, size))], [np.zeros((size, n)), mode]])
    unseen = rng.random() < 0.5
    p["B1"] = np.vstack([p["B1"], q["B1"] if unseen else 0 * q["B1"]])
    p["C1"] = np.hstack([p["C1"], 0 * q["C1"] if unseen else q["C1"]])
    p["B2"], p["C2"] = np.vstack([p["B2"], q["B2"]]), np.hstack([p["C2"], q["C2"]])
    return p


def near_axis_zeros(rng):
    """The same with the mode 1e-3 to 1e-7 off the axis, to either side, relative to its frequency."""
    p = axis_zeros(rng)
    size = 2 if p["A"][-1, -1] == 0.0 and p["A"].shape[0] > 1 and p["A"][-2, -1] > 0.0 else 1
    omega = p["A"][-2, -1] if size == 2 else 1.0
    shift = 10 ** rng.uniform(-7, -3) * omega * rng.choice([-1.0, 1.0])
    # An uncoupled pole of this damping is a zero of the path that does not see it.
    p["A"][-size:, -size:] += shift * np.eye(size)
    return p


def series(p_first, p_second):
    """(a, b, c, d) of p_second after p_first, one signal between them."""
    a1, b1, c1, d1 = p_first
    a2, b2, c2, d2 = p_second
    a = np.block([[a1, np.zeros((len(a1), len(a2)))], [b2 @ c1, a2]])
    return a, np.vstack([b1, b2 @ d1]), np.hstack([d2 @ c1, c2]), d2 @ d1


def mixed_sensitivity(rng):
    """S and KS of a chain with integrators, each shifted off the axis by 1e-3 to 1e-8, in its minimal form."""
    n_lags, n_integrators = int(rng.integers(1, 5)), int(rng.integers(1, 3))
    shift = 10 ** rng.uniform(-8, -3)
    poles = [-(10 ** rng.uniform(-1, 3)) for _ in range(n_lags)] + [-shift] * n_integrators
    g = (np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.eye(1))
    for pole in poles:
        gain = -pole if pole < -shift else 1.0
        g = series(g, (np.array([[pole]]), np.array([[1.0]]), np.array([[gain]]), np.zeros((1, 1))))
    a, b, c, _ = g
    omega_b, level = 10 ** rng.uniform(-1, 1), rng.uniform(0.3, 0.7)
    weight_pole = -(10 ** rng.uniform(-8, -3))
    n = len(a)
    # e = r - g u; we = level + omega_b / (s - weight_pole), driven by e; the last output of z is wu u.
    a_all = np.block([[a, np.zeros((n, 1))], [-c, np.array([[weight_pole]])]])
    return {
        "A": a_all, "B1": np.vstack([np.zeros((n, 1)), [[1.0]]]), "B2": np.vstack([b, [[0.0]]]),
        "C1": np.vstack([np.hstack([-level * c, [[omega_b]]]), np.zeros((1, n + 1))]), "C2": np.hstack([-c, [[0.0]]]),
        "D11": np.array([[level], [0.0]]), "D12": np.array([[0.0], [10 ** rng.uniform(-3, 0)]]),
        "D21": np.eye(1), "D22": np.zeros((1, 1)),
    }


def small(rng):
    """One or two states, one signal at each port."""
    p = problem(rng, int(rng.integers(1, 3)), 1, 1, 1, 1)
    p["D11"] = rng.standard_normal((1, 1)) * rng.integers(0, 2)
    return p


def large(rng):
    p = problem(rng, int(rng.integers(16, 26)), 3, 2, 3, 2)
    p["A"] -= (abscissa(p["A"]) - rng.uniform(-1.0, 0.5)) * np.eye(len(p["A"]))
    return p


def refused(rng):
    """An unstable mode that u does not reach, or that y does not see."""
    p = stable(rng)
    n = len(p["A"])
    p["A"][-1, :], p["A"][:, -1] = 0.0, 0.0
    p["A"][-1, -1] = 0.5
    if rng.random() < 0.5:
        p["B2"][-1] = 0.0
        p["expect"] = {"status": "not_stabilizable", "reason": "u does not reach the last state, whose pole is +0.5"}
    else:
        p["C2"][:, -1] = 0.0
        p["expect"] = {"status": "not_detectable", "reason": "y does not see the last state, whose pole is +0.5"}
    assert n == len(p["A"])
    return p


def main():
    problems = []
    classes = [stable, unstable, flexible, stiff, scaled, large_d11, with_d22, nearly_singular, singular, axis_zeros,
               near_axis_zeros, mixed_sensitivity, small, large, refused]
    for index, make in enumerate(classes):
        for k in range(4 if make is refused else PER_CLASS):
            rng = np.random.default_rng([SEED, index, k])
            p = make(rng)
            category = make.__name__.replace("_", "-")
            head = {"id": f"{category}_{k}", "category": category, "source": f"default_rng([{SEED}, {index}, {k}])"}
            nz, nw = p["D11"].shape
            head |= {"n": len(p["A"]), "nw": nw, "nu": p["B2"].shape[1], "nz": nz, "ny": p["C2"].shape[0]}
            head["regular"] = category not in ("singular", "axis-zeros")
            expect = p.pop("expect", None)
            body = {key: [[float(f"{x:.6g}") + 0.0 for x in row] for row in m.tolist()] for key, m in p.items()}
            problems.append(head | body | ({"expect": expect} if expect else {"gamma_ref": None}))
    note = "Made by make_stress.py; gamma_ref by reference_gamma.py. gamma_ref_accuracy is relative."
    lines = ",\n".join(json.dumps(p, separators=(",", ":")) for p in problems)
    sys.stdout.write(f'{{"note": "{note}",\n"problems": [\n{lines}\n]}}\n')


main()
