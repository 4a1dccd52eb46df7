"""Judges `telepulse membrane solve` by stored values and, on random cases, by scipy's boundary-value solver.

Usage: python3 .ci/check_membrane.py target/release/telepulse STATIC.json DEVICES.json

STATIC.json holds dimensionless cases (lengths over B, stresses over mu), DEVICES.json parameter sets with a table over voltage. A
collection that does not exist is skipped, and the output says so; the random cases are judged in any case.
"""

import json
import math
import pathlib
import random
import subprocess
import sys

import numpy
import scipy.integrate

VACUUM = 8.8541878128e-12
SEED = 20261128
N_RANDOM = 40
failures = []
counts = {"stored": 0, "random": 0, "refused": 0}


def check(holds, what):
    if not holds:
        print("FAILED " + what)
        failures.append(what)


def near(found, expected, relative, what):
    check(
        isinstance(found, float) and abs(found - expected) <= relative * max(abs(expected), 1e-300),
        f"{what}: {found} for {expected}",
    )


def ask(program, case):
    """The answer, or None where the case was refused as it should be: exit code 2, one line, nothing on standard output."""
    done = subprocess.run(
        [program, "membrane", "solve", "-", "--json"], input=json.dumps(case), capture_output=True, text=True, timeout=60
    )
    if done.returncode == 2:
        check(done.stdout == "" and len(done.stderr.splitlines()) == 1, f"refusal of {case}: {done.stderr!r}")
        return None
    check(done.returncode == 0, f"{case}: exit code {done.returncode}")
    answer = json.loads(done.stdout, parse_constant=lambda word: check(False, f"{case}: answered {word}"))
    return answer


def energy_slopes(material, l1, l2):
    """dW/dl1 and dW/dl2; analytic in complex stretches, so that a complex step differentiates them."""
    if material["model"] == "ogden":
        l3 = 1 / (l1 * l2)
        first = sum(mu * (l1**a - l3**a) for mu, a in material["terms"]) / l1
        second = sum(mu * (l2**a - l3**a) for mu, a in material["terms"]) / l2
        return first, second
    factor = material["mu_pa"]
    if material["model"] == "gent":
        factor = factor * material["J"] / (material["J"] - (l1**2 + l2**2 + (l1 * l2) ** -2 - 3))
    return factor * (l1 - l1**-3 * l2**-2), factor * (l2 - l2**-3 * l1**-2)


def stresses(case, l1, l2):
    permittivity = VACUUM * case["relative_permittivity"]
    pressure = permittivity * (case["voltage_v"] / case["thickness_m"]) ** 2
    first, second = energy_slopes(case["material"], l1, l2)
    return first - pressure * l1 * l2**2, second - pressure * l1**2 * l2


def boundary_value(case, answer, force_n):
    """The membrane by scipy in (r, z, theta, l1), started from a crude shape through the answer's two ends."""
    stretch = case["prestretch"]
    inner, outer = case["a_m"] / stretch, case["b_m"] / stretch
    scale = outer
    lead = force_n / (2 * math.pi * case["thickness_m"])

    def slopes(radius, y):
        radius = radius * scale
        r, _, theta, l1 = y[0] * scale, y[1], y[2], y[3]
        l2 = r / radius
        s1, s2 = stresses(case, l1, l2)
        step = 1e-30
        by1 = stresses(case, l1 + 1j * step, l2)[0].imag / step
        by2 = stresses(case, l1, l2 + 1j * step)[0].imag / step
        cosine, sine = numpy.cos(theta), numpy.sin(theta)
        dl1 = (s2 * cosine - s1 - by2 * (l1 * cosine - l2)) / (radius * by1)
        return scale * numpy.vstack([l1 * cosine / scale, -l1 * sine / scale, -s2 * sine / (radius * s1), dl1])

    def ends(at_plate, at_frame):
        s1 = stresses(case, at_plate[3], at_plate[0] * scale / inner)[0]
        pull = inner * s1 * math.sin(at_plate[2]) - lead
        unit = inner * abs(stresses(case, stretch, stretch)[0]) + abs(lead)
        return numpy.array(
            [at_plate[0] - case["a_m"] / scale, at_frame[0] - case["b_m"] / scale, at_frame[1], pull / unit]
        )

    mesh = numpy.geomspace(inner / scale, 1.0, 120)
    part = (1 / mesh - 1) / (scale / inner - 1)
    guess = numpy.vstack(
        [
            stretch * mesh,
            answer["displacement_m"] / scale * numpy.log(mesh) / math.log(inner / scale),
            answer["theta_outer"] + (answer["theta_inner"] - answer["theta_outer"]) * part,
            answer["lambda1_outer"] + (answer["lambda1_inner"] - answer["lambda1_outer"]) * part**2,
        ]
    )
    # Rounding may keep the tightest residual out of reach; each of these is enough for 1e-8.
    for tolerance in (1e-11, 1e-10, 3e-10):
        found = scipy.integrate.solve_bvp(slopes, ends, mesh, guess, tol=tolerance, bc_tol=1e-12, max_nodes=60_000)
        if found.success:
            return found, scale
    return None, scale


def judge_random(program, case, answer, with_derivatives):
    what = f"random case {json.dumps(case)}"
    check(answer["residual"] <= 1e-9, f"{what}: residual {answer['residual']}")
    solved, scale = boundary_value(case, answer, case["force_n"])
    if solved is None:
        check(False, f"{what}: scipy finds nothing")
        return
    # 1e-8: the tolerance of the residual, 1e-11, times what the thinnest boundary layers here make of it.
    r, z, theta, l1 = solved.sol(numpy.array([solved.x[0], 1.0]))
    for key, expected in [
        ("displacement_m", z[0] * scale),
        ("theta_inner", theta[0]),
        ("theta_outer", theta[1]),
        ("lambda1_inner", l1[0]),
        ("lambda1_outer", l1[1]),
        ("s1_inner_pa", stresses(case, l1[0], case["prestretch"])[0]),
    ]:
        near(answer[key], float(expected), 1e-8, f"{what}: {key}")
    nodes, weights = numpy.polynomial.legendre.leggauss(200)
    low, high = math.log(solved.x[0]), 0.0
    grid = numpy.exp(0.5 * (high - low) * nodes + 0.5 * (high + low))
    r, z, theta, l1 = solved.sol(grid)
    l2 = r / grid
    permittivity = VACUUM * case["relative_permittivity"]
    density = 2 * math.pi * grid * scale * (l1 * l2) ** 2 * grid * scale * 0.5 * (high - low)
    near(
        answer["capacitance_f"],
        float(permittivity / case["thickness_m"] * (weights @ density)),
        1e-8,
        f"{what}: capacitance_f",
    )
    if with_derivatives:
        # Central differences of scipy's solution, extrapolated: about 1e-11/1e-3 of noise, 1e-12 of truncation.
        def at(part):
            moved, scale = boundary_value(case, answer, case["force_n"] * (1 + part))
            return float(moved.sol(moved.x[0])[1] * scale)

        slope = lambda h: (at(h) - at(-h)) / (2 * h * case["force_n"])
        compliance = (4 * slope(1e-3) - slope(2e-3)) / 3
        near(answer["stiffness_n_per_m"], 1 / compliance, 1e-6, f"{what}: stiffness")


def random_case(draw):
    outer, mu = 0.02 * 5 ** draw.random(), 10 ** (4 + draw.random())
    thickness, permittivity = outer * 10 ** (-2.5 + draw.random()), 2 + 6 * draw.random()
    stretch = 1.2 + 1.8 * draw.random()
    material = {"model": "neo-hookean", "mu_pa": mu}
    kind = draw.randrange(3)
    if kind == 1:
        material = {"model": "gent", "mu_pa": mu, "J": 40 + 100 * draw.random()}
    if kind == 2:
        material = {"model": "ogden", "terms": [[mu * 0.7, 2 + 0.5 * draw.random()], [-mu * 0.15, -2.0]]}
    load = 0.3 * draw.random() ** 2 + 1e-3
    return {
        "material": material,
        "a_m": outer * stretch * (0.1 + 0.5 * draw.random()),
        "b_m": outer * stretch,
        "thickness_m": thickness,
        "prestretch": stretch,
        "relative_permittivity": permittivity,
        "voltage_v": 0.35 * draw.random() * thickness * math.sqrt(mu / (VACUUM * permittivity)),
        "force_n": load * 2 * math.pi * mu * thickness * outer,
    }


def judge_stored_static(program, path):
    outer, thickness, mu, permittivity = 0.04, 1e-3, 5e4, 4.0
    for stored in json.loads(path.read_text())["cases"]:
        if stored["material"] != "neo-Hookean":
            continue
        stretch = stored["prestretch"]
        case = {
            "material": {"model": "neo-hookean", "mu_pa": mu},
            "a_m": stretch * stored["A_over_B"] * outer,
            "b_m": stretch * outer,
            "thickness_m": thickness,
            "prestretch": stretch,
            "relative_permittivity": permittivity,
            "voltage_v": stored["v"] * thickness * math.sqrt(mu / (VACUUM * permittivity)),
            "force_n": stored["f"] * 2 * math.pi * mu * thickness * outer,
        }
        answer = ask(program, case)
        what = f"stored case {stored['id']}"
        check(answer is not None, what + " was refused")
        if answer is None:
            continue
        counts["stored"] += 1
        near(answer["displacement_m"], stored["u_over_B"] * outer, 1e-9, f"{what}: displacement_m")
        for key in ("lambda1_inner", "lambda1_outer", "theta_inner", "theta_outer"):
            near(answer[key], stored[key], 1e-9, f"{what}: {key}")
        near(answer["s1_inner_pa"], stored["s1_inner"] * mu, 1e-9, f"{what}: s1_inner_pa")
        stiffness = 2 * math.pi * mu * thickness / stored["compliance_du_df"]
        near(answer["stiffness_n_per_m"], stiffness, 1e-6, f"{what}: stiffness")


def judge_stored_devices(program, path):
    for name, device in json.loads(path.read_text()).items():
        params, geometry = device["params"], device["geometry"]
        for row in device["table"]:
            case = {
                "material": {"model": "gent", "mu_pa": params["mu"], "J": params["J"]},
                "a_m": geometry["a"],
                "b_m": geometry["b"],
                "thickness_m": geometry["H"],
                "prestretch": geometry["prestretch"],
                "relative_permittivity": params["epsr"],
                "voltage_v": row["V"],
                "force_n": geometry["mass"] * geometry["g"],
            }
            answer = ask(program, case)
            what = f"{name} at {row['V']} V"
            check(answer is not None, what + " was refused")
            if answer is None:
                continue
            counts["stored"] += 1
            for key, expected, relative in [
                ("displacement_m", 1e-3 * row["x_mm"], 1e-9),
                ("theta_inner", row["theta_inner"], 1e-9),
                ("lambda1_inner", row["lambda1_inner"], 1e-9),
                ("capacitance_f", 1e-9 * row["C_nF"], 1e-9),
                ("stiffness_n_per_m", row["k_relaxed_N_m"], 1e-6),
                ("field_max_v_per_m", 1e6 * row["E_true_max_MV_m"], 1e-9),
            ]:
                near(answer[key], expected, relative, f"{what}: {key}")
            if row["V"] > 0:
                near(answer["dforce_dvoltage_n_per_v"], row["dFdV_relaxed_N_per_V"], 1e-6, f"{what}: dF/dV")


def main():
    program, static, devices = sys.argv[1], pathlib.Path(sys.argv[2]), pathlib.Path(sys.argv[3])
    for path, judge in [(static, judge_stored_static), (devices, judge_stored_devices)]:
        if path.exists():
            judge(program, path)
        else:
            print(f"skipped: there is no {path}")
    draw = random.Random(SEED)
    while counts["random"] < N_RANDOM and counts["refused"] < N_RANDOM:
        case = random_case(draw)
        answer = ask(program, case)
        if answer is None:
            counts["refused"] += 1
            continue
        judge_random(program, case, answer, with_derivatives=counts["random"] < 8)
        counts["random"] += 1
    check(counts["random"] == N_RANDOM, f"only {counts['random']} random cases were answered, seed {SEED}")
    print(f"membrane: {counts}, seed {SEED}, {len(failures)} failures")
    sys.exit(1 if failures else 0)


main()
