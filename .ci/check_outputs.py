"""Checks what the README's main command wrote: report.json against what the study must show, and every file named.

Usage: python3 .ci/check_outputs.py out/diaphragm-2017
"""

import json
import math
import pathlib
import re
import sys
import xml.etree.ElementTree as ElementTree

CONDITIONS = ("normal", "disturbance", "noise", "both")
failures = []


def check(holds, what):
    print(("ok    " if holds else "FAILED ") + what)
    if not holds:
        failures.append(what)


def numbers(value, path=""):
    """Yields every number in the report with its path."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from numbers(item, f"{path}.{key}")
    elif isinstance(value, list):
        for idx, item in enumerate(value):
            yield from numbers(item, f"{path}[{idx}]")
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        yield path, value


folder = pathlib.Path(sys.argv[1])
report = json.loads((folder / "report.json").read_text())

check(all(math.isfinite(number) for _, number in numbers(report)), "every number is finite")

identified = report["identified"]
check(abs(identified["dc_gain_mm_per_unit"] / 0.935 - 1) <= 0.02, f"DC gain {identified['dc_gain_mm_per_unit']:.4f} within 2 % of 0.935")
check(abs(identified["omega_n_rad_s"] / 38.0 - 1) <= 0.02, f"omega_n {identified['omega_n_rad_s']:.3f} within 2 % of 38.0")
check(abs(identified["zeta"] - 0.21) <= 0.03, f"zeta {identified['zeta']:.4f} within 0.03 of 0.21")
check(identified["bound_violations"] == 0, "no error point above the bound")

synthesis = report["synthesis"]
check(0.3206 <= synthesis["gamma_achieved"] <= 0.3240, f"gamma {synthesis['gamma_achieved']:.6f} within 0.3206 and 0.3240")
check(synthesis["fastest_pole_rad_s"] < 1e5, f"fastest controller pole {synthesis['fastest_pole_rad_s']:.0f} rad/s below 1e5")

printed = report["printed"]
for key, value, tolerance in (("norm_ms", 1.7689, 1e-4), ("norm_ws", 0.24262, 1e-5), ("small_gain_limit", 4.1218, 2e-4), ("frequency_wise", 0.209, 5e-4)):
    check(abs(printed[key] - value) <= tolerance, f"printed {key} {printed[key]:.5f}")

tracking = report["tracking"]
for condition in CONDITIONS:
    error = tracking["printed_k"][condition]["mean_abs_error_mm"]
    check(0.008 <= error <= 0.014, f"printed K, {condition}: {error:.5f} mm within 0.008 and 0.014")
    error = tracking["best"][condition]["mean_abs_error_mm"]
    check(error <= 0.0005, f"best, {condition}: {error:.6f} mm at most 0.0005")
    effort = [tracking[name][condition]["effort_index"] for name in ("best", "printed_k")]
    check(abs(effort[0] / effort[1] - 1) <= 0.05, f"best, {condition}: effort {effort[0]:.4f} within 5 % of the printed K's {effort[1]:.4f}")
for controller in ("printed_k", "hinf", "best", "pid_auto", "pid_manual"):
    for condition in CONDITIONS:
        run = tracking[controller][condition]
        if not run.get("unstable"):
            check(0 <= run["min_voltage_v"] and run["max_voltage_v"] <= 5000, f"{controller}, {condition}: voltage within 0 and 5 kV")

for point in report["bias_sweep"]:
    if point["controller"] == "best":
        check(point["stable"] and point["gain_margin"] >= 2, f"best at bias {point['bias']}: stable, gain margin {point['gain_margin']:.2f} at least 2")
unstable = [point["bias"] for point in report["bias_sweep"] if point["controller"] == "printed_k" and not point["stable"]]
check(unstable and min(unstable) == 0.8, f"printed K is unstable from bias {min(unstable, default=None)} on")

pulse = report["pulse"]
best = pulse["best"]["displacement"]
check(abs(best["lag_ms"]) <= 2, f"best, displacement: lag {best['lag_ms']:.3f} ms")
check(best["nrmse"] <= 0.03, f"best, displacement: NRMSE {100 * best['nrmse']:.3f} %")
for controller in ("printed_k", "hinf", "best"):
    for mode in ("displacement", "force"):
        run = pulse[controller][mode]
        if not run.get("unstable"):
            check(0 <= run["min_voltage_v"] and run["max_voltage_v"] <= 5000, f"{controller}, {mode}: voltage within 0 and 5 kV")

check(len(report["pulse_files"]) == 8, "eight recordings are followed")
for name, runs in report["pulse_files"].items():
    run = runs["250"]
    check(abs(run["lag_ms"]) <= 0.5 and run["nrmse"] <= 0.005, f"{name}, known 250 ms ahead: lag {run['lag_ms']:.3f} ms, NRMSE {100 * run['nrmse']:.3f} %")
    check(set(runs) == {"250", "100", "40", "20", "0"} and all(r["nrmse"] is not None for r in runs.values()), f"{name}: followed at every horizon")
check(len(report["pulse_force"]) == 8, "eight recordings are felt")
for name, run in report["pulse_force"].items():
    check(abs(run["lag_ms"]) <= 1 and run["nrmse"] <= 0.01, f"{name}, force mode, contact stiffness +-50 %: lag {run['lag_ms']:.3f} ms, NRMSE {100 * run['nrmse']:.3f} %")

link = report["link"]
check(link["sent"] == link["received"] > 0 and link["bit_exact"], f"link: {link['received']} samples bit for bit")
check(link["lost"] == link["duplicated"] == link["out_of_order"] == 0, "link: none lost, duplicated or out of order")
check(link["processes"] >= 2, "link: patient and doctor are separate processes")
check(len(report["disagreements"]) >= 10, f"{len(report['disagreements'])} disagreements listed")

html = (folder / "report.html").read_text()
check("Plotly.newPlot" in html or "Plotly.react" in html, "report.html draws figures")
loaded = re.findall(r"""<(?:script|img|iframe)[^>]*\ssrc=["'](?!data:)([^"']+)|<link[^>]*\shref=["']([^"']+)|@import""", html)
check(not loaded, "report.html loads nothing from elsewhere")
figures = sorted((folder / "figures").glob("*.svg"))
check(len(figures) >= 11, f"{len(figures)} figures")
for figure in figures:
    root = ElementTree.fromstring(figure.read_text())
    drawn = sum(1 for _ in root.iter())
    check(drawn > 20, f"{figure.name}: {drawn} elements")

print(f"checks: {len(failures)} failed")
sys.exit(1 if failures else 0)
