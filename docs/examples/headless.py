"""Capture, analyse and report without the command line.

Usage: .venv/bin/python docs/examples/headless.py OUT [RIG [SCENE [PLAN]]]
"""
# ruff: noqa: T201

import sys

import labrig

out, *given = sys.argv[1:]
defaults = ["rigs/simulated.yaml", "scenes/dilute-milk.yaml", "plans/six-shifts.yaml"]
files = [labrig.config_folder() / name for name in defaults]
rig_file, scene_file, plan_file = given + files[len(given) :]

plan = labrig.load_plan(plan_file)
with labrig.open_rig(rig_file, scene_file, plan) as rig:
    session = labrig.capture(plan, rig, out)
result = labrig.analyse(session)
page = labrig.report(result)

for name in ("sigma_t_per_mm", "sigma_s_per_mm", "g"):
    found = result.run[name]
    print(f"{name:15} {found['value']:.5g} ± {found['std']:.2g}")
print(page)
