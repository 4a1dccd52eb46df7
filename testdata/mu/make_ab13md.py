"""Upper bounds of the structured singular value by SLICOT's AB13MD, through slycot.

Run: python make_ab13md.py > ab13md.json
Structures: a list of [kind, size], kind "real" (1 x 1) or "full" (size x size). Matrices are drawn with a fixed seed; every
third one has rows and columns scaled over four decades.
"""
import json
import sys

import numpy
import slycot

STRUCTURES = [
    [["full", 1]] * 2,
    [["full", 1]] * 4,
    [["full", 1]] * 8,
    [["full", 2], ["full", 2]],
    [["full", 1], ["full", 3]],
    [["full", 2], ["full", 1], ["full", 3]],
    [["real", 1], ["full", 1]],
    [["real", 1], ["real", 1], ["full", 2]],
    [["real", 1], ["real", 1], ["full", 1], ["full", 1]],
    [["real", 1], ["real", 1], ["real", 1], ["full", 1], ["full", 2], ["full", 1]],
]

rng = numpy.random.default_rng(20260111)
cases = []
for blocks in STRUCTURES:
    n = sum(size for _, size in blocks)
    for trial in range(6):
        m = rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n))
        if trial % 3 == 2:
            scale = 10.0 ** rng.uniform(-2, 2, n)
            m = m * scale[:, None] / scale[None, :]
        sizes = [size for _, size in blocks]
        kinds = [1 if kind == "real" else 2 for kind, _ in blocks]
        bound, _, _, _ = slycot.ab13md(m, sizes, kinds)
        cases.append({
            "blocks": blocks,
            "re": [[float(v) for v in row] for row in m.real],
            "im": [[float(v) for v in row] for row in m.imag],
            "ab13md": float(bound),
        })
json.dump({
    "made_by": f"make_ab13md.py, slycot {slycot.__version__}, numpy {numpy.__version__}",
    "cases": cases,
}, sys.stdout)
