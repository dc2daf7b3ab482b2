"""Capture five dilutions on the simulated rig, analyse each, and compare them.

Run as ``python docs/examples/dilution_series.py OUT``; it leaves sessions, a table and a figure.
"""

import sys
from pathlib import Path

import labrig
from labrig import cli


def main(out: Path) -> int:
    """Do it all; return the exit code of the comparison."""
    configs = labrig.config_folder()
    plan = labrig.load_plan(configs / "plans" / "six-shifts.yaml")
    sessions = []
    for scene in sorted((configs / "scenes").glob("dilution-*.yaml")):
        with labrig.open_rig(configs / "rigs" / "simulated.yaml", scene, plan) as rig:
            session = labrig.capture(plan, rig, out / "sessions")
        found = labrig.analyse(session).run
        sys.stdout.write(f"{scene.stem}: {found['sigma_t_per_mm']['value']:.5f} / mm\n")
        sessions.append(str(session))
    known = configs / "series" / "dilutions.yaml"
    return cli.run(["series", *sessions, "--concentration", str(known), "--out", str(out)])


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else "series")))
