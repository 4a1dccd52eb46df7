"""Adds `gamma_ref`, the smallest reachable norm, to every problem of a collection by 320-bit arithmetic.

    python3 reference_gamma.py solve_stress.json [id ...]          (python-flint 0.9; ten minutes)
    python3 reference_gamma.py --check COLLECTION.json             (compares with the `gamma_ref` that are there)

It shares nothing with the solver under test: the plant is not normalized, the stable subspaces come from Newton's
iteration for the matrix sign (no eigenvalues, no Schur form), and 96 decimal digits stand in for care about rounding.
Conditions: Zhou, Doyle and Glover, Robust and Optimal Control (1996), section 16.4 and 17.1, for gamma above Parrott's
bound: X and Y exist and are positive semidefinite, and gamma^2 exceeds the spectral radius of XY.

A singular problem is replaced by a regular one: `EPSILON` times u and x are added to z, the same of new disturbances to
y and to the state derivatives. Its optimum falls to that of the problem as epsilon does. It is found for `EPSILON` and
for a thousand times as much; the difference is stored as `gamma_ref_accuracy` where it exceeds the bracket's.
"""

import json
import sys

from flint import arb, arb_mat, ctx, fmpq

ctx.prec = 320
EPSILON = "1e-15"
RELATIVE_WIDTH = 2e-9
TINY = arb("1e-55")


def zeros(rows, cols):
    return arb_mat(rows, cols)


def identity(n):
    return arb_mat(n, n, [int(i == j) for i in range(n) for j in range(n)])


def block(rows):
    """A matrix of matrices; every row of blocks has the same heights."""
    table = [sum((part.table()[i] for part in row), []) for row in rows for i in range(row[0].nrows())]
    n_cols = sum(part.ncols() for part in rows[0])
    return arb_mat(len(table), n_cols, [x for line in table for x in line])


def scale(factor, m):
    return arb_mat(m.nrows(), m.ncols(), [factor * x for x in m.entries()])


def parts(m, row, rows, col, cols):
    return arb_mat(rows, cols, [m[row + i, col + j] for i in range(rows) for j in range(cols)])


class Plant:
    def __init__(self, problem):
        n, nw, nu, nz, ny = (problem[key] for key in ("n", "nw", "nu", "nz", "ny"))

        def matrix(key, rows, cols):
            return arb_mat(rows, cols, [arb(str(x)) for line in problem[key] for x in line])

        self.a, self.b1, self.b2 = matrix("A", n, n), matrix("B1", n, nw), matrix("B2", n, nu)
        self.c1, self.c2 = matrix("C1", nz, n), matrix("C2", ny, n)
        self.d11, self.d12, self.d21 = matrix("D11", nz, nw), matrix("D12", nz, nu), matrix("D21", ny, nw)

    def enlarged(self, epsilon):
        """Weights on u and x, noise on y and x."""
        n, nw, nu = self.b1.nrows(), self.b1.ncols(), self.b2.ncols()
        nz, ny = self.c1.nrows(), self.c2.nrows()
        other = Plant.__new__(Plant)
        other.a, other.b2, other.c2 = self.a, self.b2, self.c2
        other.b1 = block([[self.b1, zeros(n, ny), scale(epsilon, identity(n))]])
        other.c1 = block([[self.c1], [zeros(nu, n)], [scale(epsilon, identity(n))]])
        other.d12 = block([[self.d12], [scale(epsilon, identity(nu))], [zeros(n, nu)]])
        other.d21 = block([[self.d21, scale(epsilon, identity(ny)), zeros(ny, n)]])
        other.d11 = block([[self.d11, zeros(nz, ny + n)], [zeros(nu + n, nw + ny + n)]])
        return other

    def dual(self):
        other = Plant.__new__(Plant)
        other.a, other.d11 = self.a.transpose(), self.d11.transpose()
        other.b1, other.b2 = self.c1.transpose(), self.c2.transpose()
        other.c1, other.c2 = self.b1.transpose(), self.b2.transpose()
        other.d12, other.d21 = self.d21.transpose(), self.d12.transpose()
        return other


def half_factor(m):
    """L with m = L L' by Cholesky with diagonal pivots; None where m is not positive semidefinite to 50 digits."""
    n = m.nrows()
    a = [[m[i, j].mid() for j in range(n)] for i in range(n)]
    # Of the 96 digits a badly scaled problem loses up to forty; what is below this is zero.
    zero = max([abs(x) for row in a for x in row] + [arb(1)]) * TINY
    sizes = [max(zero, abs(a[i][i]) * TINY) for i in range(n)]
    columns, left = [], set(range(n))
    while left:
        if any(a[i][i] < -sizes[i] for i in left):
            return None
        left = {i for i in left if a[i][i] > sizes[i]}
        if not left:
            break
        pivot = max(left, key=lambda i: float(a[i][i] / sizes[i]))
        root = a[pivot][pivot].sqrt()
        column = [(a[i][pivot] / root).mid() if i in left else arb(0) for i in range(n)]
        left.remove(pivot)
        for i in left:
            for j in left:
                a[i][j] = (a[i][j] - column[i] * column[j]).mid()
        columns.append(column)
    return arb_mat(n, len(columns), [columns[j][i] for i in range(n) for j in range(len(columns))])


def is_definite(m):
    """Whether a symmetric matrix is positive definite."""
    factor = half_factor(m)
    return factor is not None and factor.ncols() == m.nrows()


def frobenius(m):
    return sum((x * x for x in m.entries()), arb(0)).mid().sqrt()


def riccati(h):
    """X with [I; X] spanning the stable subspace of a Hamiltonian; None where it has eigenvalues on the axis."""
    n = h.nrows() // 2
    s, settled = h, False
    for _ in range(STEPS_MAX):
        try:
            inverse = s.inv().mid()
        except ZeroDivisionError:
            return None
        factor = arb(1) if settled else (frobenius(inverse) / frobenius(s)).sqrt().mid()
        following = scale(arb(0.5), scale(factor, s) + scale(1 / factor, inverse)).mid()
        change = frobenius(following - s) / frobenius(following)
        s, settled = following, settled or change < arb("1e-2")
        if change < arb("1e-45"):
            break
    else:
        return None
    # With eigenvalues on the axis the iteration wanders and may overflow into the sign of some other matrix.
    if frobenius((h * s - s * h).mid()) > arb("1e-30") * frobenius(h) * frobenius(s):
        return None
    trace = sum((s[i, i] for i in range(2 * n)), arb(0))
    if abs(trace.mid()) > arb("0.5"):
        return None
    left = block([[parts(s, 0, n, n, n)], [parts(s, n, n, n, n) + identity(n)]])
    right = block([[parts(s, 0, n, 0, n) + identity(n)], [parts(s, n, n, 0, n)]])
    try:
        x = (left.transpose() * left).mid().inv().mid() * (left.transpose() * right)
    except ZeroDivisionError:
        return None
    return scale(arb(-0.5), x + x.transpose()).mid()


def control_riccati(p, gamma):
    """X of the control problem, None where it does not exist or gamma is below Parrott's bound."""
    nw, nu, nz = p.b1.ncols(), p.b2.ncols(), p.c1.nrows()
    gamma2 = gamma * gamma
    # Parrott: gamma^2 - D11' (I - projection onto D12) D11 > 0.
    gram = (p.d12.transpose() * p.d12).mid().inv().mid()
    beyond = identity(nz) - p.d12 * gram * p.d12.transpose()
    if not is_definite((scale(gamma2, identity(nw)) - p.d11.transpose() * beyond * p.d11).mid()):
        return None
    d = block([[p.d11, p.d12]])
    b = block([[p.b1, p.b2]])
    shift = block([[scale(gamma2, identity(nw)), zeros(nw, nu)], [zeros(nu, nw), zeros(nu, nu)]])
    r = (d.transpose() * d - shift).mid().inv().mid()
    cross = p.c1.transpose() * d
    a_h = p.a - b * r * cross.transpose()
    h = block([
        [a_h, scale(arb(-1), b * r * b.transpose())],
        [scale(arb(-1), p.c1.transpose() * p.c1 - cross * r * cross.transpose()), scale(arb(-1), a_h.transpose())],
    ]).mid()
    return riccati(h)


def is_feasible(p, gamma):
    gamma = arb(gamma)
    x = control_riccati(p, gamma)
    half = None if x is None else half_factor(x)
    if half is None:
        return False
    y = control_riccati(p.dual(), gamma)
    if y is None or half_factor(y) is None:
        return False
    coupled = scale(gamma * gamma, identity(half.ncols())) - half.transpose() * y * half
    return is_definite(coupled.mid())


def optimum(p):
    """Bracket of the smallest reachable norm."""
    low, high = None, 1.0
    while not is_feasible(p, high):
        low, high = high, 10.0 * high
        if high > 1e12:
            return None
    while low is None and high > 1e-14:
        if is_feasible(p, high / 10.0):
            high /= 10.0
        else:
            low = high / 10.0
    if low is None:
        return 0.0
    while high > low * (1.0 + RELATIVE_WIDTH):
        middle = (low * high) ** 0.5
        low, high = (low, middle) if is_feasible(p, middle) else (middle, high)
    return high


def reference(problem):
    """(gamma, relative accuracy)."""
    plant = Plant(problem)
    if problem["regular"]:
        return optimum(plant), RELATIVE_WIDTH
    coarse, fine = (optimum(plant.enlarged(arb(EPSILON) * factor)) for factor in (1000, 1))
    if not fine:
        return fine, 1.0
    return fine, max(RELATIVE_WIDTH, coarse / fine - 1.0)


def write(path, collection):
    lines = ",\n".join(json.dumps(p, separators=(",", ":")) for p in collection["problems"])
    with open(path, "w") as file:
        file.write(f'{{"note": {json.dumps(collection["note"])},\n"problems": [\n{lines}\n]}}\n')


def main():
    only_check = sys.argv[1] == "--check"
    path, *names = sys.argv[2:] if only_check else sys.argv[1:]
    with open(path) as file:
        collection = json.load(file)
    for problem in collection["problems"]:
        if "expect" in problem and problem["expect"]["status"] != "ok" or names and problem["id"] not in names:
            continue
        gamma, accuracy = reference(problem)
        print(problem["id"], problem["n"], gamma, accuracy, problem.get("gamma_ref"), flush=True)
        if not only_check:
            problem["gamma_ref"], problem["gamma_ref_accuracy"] = gamma, float(f"{accuracy:.2g}")
    if not only_check:
        write(path, collection)


STEPS_MAX = 120

if __name__ == "__main__":
    main()
