"""Tell whether the stated std is the scatter of the answers of many captures of one scene.

Run as ``python docs/examples/scatter_of_captures.py PLAN RIG SCENE [50]``. Only the noise of the
simulated camera differs. Beside the scatter stand the std that the analyses state, and the one
that ``labrig accuracy capture`` predicts without any capture.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import labrig
from labrig.accuracy.capture import NAMES, cost_of_capture

KEYS = ("sigma_t_per_mm", "sigma_s_per_mm", "g")


def main(plan_file: str, rig_file: str, scene_file: str, n: int) -> None:
    """Print a line a parameter."""
    plan, rig, scene = (
        labrig.load_plan(plan_file),
        labrig.load_rig(rig_file),
        labrig.load_scene(scene_file),
    )
    found = []
    for seed in range(n):
        camera = rig.camera.model_copy(update={"seed": 1000 + seed})
        other = rig.model_copy(update={"camera": camera})
        with tempfile.TemporaryDirectory() as folder:
            with labrig.open_rig(other, scene, plan) as opened:
                session = labrig.capture(plan, opened, Path(folder))
            run = labrig.analyse(session).run
        found.append([(run[key]["value"], run[key]["std"]) for key in KEYS])
        sys.stderr.write(f"\r{seed + 1} of {n}")
    value, stated = np.moveaxis(np.array(found), 2, 0)
    predicted = cost_of_capture(plan, rig, scene, {}).plans[0].std
    sys.stderr.write("\n")
    for k, (name, key) in enumerate(zip(NAMES, KEYS, strict=True)):
        scale = 1.0 if name == "g" else value[:, k].mean()
        scatter, said = value[:, k].std(ddof=1), stated[:, k].mean()
        foreseen = scale * predicted[name]
        sys.stdout.write(
            f"{key}: scatter {scatter:.3g}, stated {said:.3g} (ratio {scatter / said:.2f}), "
            f"predicted {foreseen:.3g} (ratio {scatter / foreseen:.2f})\n"
        )


if __name__ == "__main__":
    main(*sys.argv[1:4], n=int(sys.argv[4]) if len(sys.argv) > 4 else 50)
