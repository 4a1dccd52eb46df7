"""Computes `norm` and `omega_rad_s` in `lossy_loops.json`: the norm of loops that lose digits where they are formed.

    python3 make_lossy.py            (python-flint 0.9, numpy 2.4; rewrites lossy_loops.json)

Plants are random ones whose D12 or D21, or a direction of both, is 1e-8 to 1e-6 of the rest; controllers are such as a
synthesis in working precision returned, with gains up to 1e16. Every entry is taken as it stands in the file. Responses are
solutions of the equations of plant and controller side by side, in 240 bits; the peak is sought on 60 frequencies
over the range of all poles and refined four times by a factor of six.
"""

import json
import os

import numpy as np
from flint import acb, acb_mat, ctx

ctx.prec = 240


def exact(m):
    return acb_mat([[acb(float(v)) for v in row] for row in m])


class Loop:
    def __init__(self, case):
        p, k = ({key: np.array(case[s][key], float) for key in "ABCD"} for s in ("plant", "controller"))
        nw, nu, nz, ny = (case[key] for key in ("nw", "nu", "nz", "ny"))
        n, nk = len(p["A"]), len(k["A"])
        iu, iy, self.n_states = n + nk, n + nk + nu, n + nk
        m = np.eye(iy + ny)
        m[: self.n_states, : self.n_states] = 0.0
        m[:n, :n], m[:n, iu:iy] = -p["A"], -p["B"][:, nw:]
        m[n:iu, n:iu], m[n:iu, iy:] = -k["A"], -k["B"]
        m[iu:iy, n:iu], m[iu:iy, iy:] = -k["C"], -k["D"]
        m[iy:, :n], m[iy:, iu:iy] = -p["C"][nz:], -p["D"][nz:, nw:]
        right, out = np.zeros((len(m), nw)), np.zeros((nz, len(m)))
        right[:n], right[iy:] = p["B"][:, :nw], p["D"][nz:, :nw]
        out[:, :n], out[:, iu:iy] = p["C"][:nz], p["D"][:nz, nw:]
        self.m, self.right, self.out, self.d11 = m, exact(right), exact(out), exact(p["D"][:nz, :nw])
        poles = np.concatenate([np.linalg.eigvals(p["A"]), np.linalg.eigvals(k["A"])])
        self.sizes = np.unique(np.concatenate([np.abs(poles), np.abs(poles.imag)]))
        self.sizes = self.sizes[self.sizes > 0]

    def gain(self, omega):
        s = acb(0, float(omega))
        m = acb_mat([[acb(v) + (s if i == j < self.n_states else 0) for j, v in enumerate(map(float, row))] for i, row in enumerate(self.m)])
        t = self.out * m.solve(self.right) + self.d11
        t = [[complex(t[i, j]) for j in range(t.ncols())] for i in range(t.nrows())]
        return float(np.linalg.svd(np.array(t))[1][0])

    def peak(self):
        low, high = self.sizes.min() / 30, self.sizes.max() * 30
        grid = np.unique(np.concatenate([[0.0], np.geomspace(low, high, 60), self.sizes]))
        gains = [self.gain(w) for w in grid]
        best = max(zip(gains, grid))
        for i in np.argsort(gains)[::-1][:3]:
            a, b = grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)]
            for _ in range(4):
                ws = np.linspace(a, b, 13)
                gs = [self.gain(w) for w in ws]
                j = int(np.argmax(gs))
                best = max(best, (gs[j], ws[j]))
                a, b = ws[max(j - 1, 0)], ws[min(j + 1, 12)]
        return best


def main():
    path = os.path.join(os.path.dirname(os.path.abspath(__file__)), "lossy_loops.json")
    with open(path) as file:
        data = json.load(file)
    for case in data["loops"]:
        case["norm"], case["omega_rad_s"] = map(float, Loop(case).peak())
    lines = ",\n".join(json.dumps(case, separators=(",", ":")) for case in data["loops"])
    with open(path, "w") as file:
        file.write('{"note": "Norms by make_lossy.py.",\n"loops": [\n' + lines + "\n]}\n")


main()
