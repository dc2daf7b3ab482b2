"""Print what a plane's model makes of the light of a layer: the table of docs/slab.md.

Four media in a layer of 5 mm under air, simulated by the Monte Carlo in three dimensions (minutes
the first time, kept then), captured with camera noise and analysed.

    .venv/bin/python docs/examples/bias_of_a_plane.py [MEDIA] [HEIGHT_MM] [SURFACE_INDEX]
"""

import sys
import tempfile
from pathlib import Path

import labrig
from labrig.config import parse
from labrig.folders import config_folder

MEDIA = {  # sigma_t in 1/mm, albedo, g; width of the tank in mm, lit part, millions of paths
    "A": (0.2051, 0.5, 0.4, 75, (28.5, 46.5), 2),
    "B": (0.35, 0.85, 0.7, 40, (11, 29), 3),
    "C": (0.35, 0.95, 0.9, 40, (11, 29), 3),
    "c": (0.35, 0.95, 0.9, 75, (28.5, 46.5), 12),  # C with less noise of paths, far from walls
    "D": (0.12, 0.8, 0.1, 75, (28.5, 46.5), 2),
}
DEPTH_MM, PIXEL_MM = 60, 0.1


def prepared(
    name: str, height_mm: float, index: float, *, period_px: int = 12, seed: int = 1
) -> tuple[labrig.Plan, labrig.Rig, labrig.Scene]:
    """Return how a medium in a layer is captured: stripes of a period, and the noise's seed."""
    sigma_t, albedo, g, width_mm, lit_mm, millions = MEDIA[name]
    scene = parse(
        {
            "schema": "labrig-scene/1",
            "name": name,
            "medium": {"sigma_t_per_mm": sigma_t, "sigma_s_per_mm": albedo * sigma_t, "g": g},
            "tank": {
                "depth_mm": DEPTH_MM,
                "width_mm": width_mm,
                "height_mm": height_mm,
                "surface_index": index,
            },
            "beam": {"from_mm": lit_mm[0], "to_mm": lit_mm[1]},
            "light": {"peak_e_per_s": 2e5, "ambient_e_per_s": 300},
            "transport": {"n_paths": millions * 1_000_000, "cell_mm": 0.25, "tail": 2e-4},
        },
        labrig.Scene,
        source=name,
    )
    rows, cols = round(width_mm / PIXEL_MM), round(DEPTH_MM / PIXEL_MM)
    rig = labrig.load_rig(config_folder() / "rigs" / "simulated.yaml")
    geometry = rig.geometry.model_copy(update={"region_px": (0, 0, cols, rows)})
    camera = rig.camera.model_copy(update={"rows": rows, "cols": cols, "seed": seed})
    rig = rig.model_copy(update={"geometry": geometry, "camera": camera})
    plan = labrig.load_plan(config_folder() / "plans" / "six-shifts.yaml")
    sets = [
        one.model_copy(update={"pattern": one.pattern.model_copy(update={"period_px": period_px})})
        if one.pattern.kind == "stripes"
        else one
        for one in plan.sets
    ]
    return plan.model_copy(update={"sets": tuple(sets)}), rig, scene


def analysed(name: str, height_mm: float, index: float, folder: Path) -> dict:
    """Capture a medium in a layer, and return run.json of its analysis."""
    plan, rig, scene = prepared(name, height_mm, index)
    with labrig.open_rig(rig, scene, plan) as opened:
        session = labrig.capture(plan, opened, folder)
    return dict(labrig.analyse(session).run)


def row(name: str, run: dict) -> str:
    """Return a line of the table: deviations from the truth."""
    truth, others = run["truth"], run["alternatives"]

    def off(found: dict, key: str) -> str:
        value = found[key]["value"]
        if key == "g":
            return f"{value - truth[key]:+.3f}"
        return f"{100 * (value / truth[key] - 1):+.1f} %"

    t, s = "sigma_t_per_mm", "sigma_s_per_mm"
    paper, plane, quality = others["separated"], others.get("flatland"), run["quality"]["slab"]
    cells = [f"{name} {MEDIA[name][:3]}", f"{off(paper, t)}; {off(paper, s)}; {off(paper, 'g')}"]
    misfit = quality["chi2_per_dof_of_plane"]
    cells.append(
        "—"
        if plane is None or plane["g"]["value"] is None
        else f"{off(plane, t)}; {off(plane, s)}; {off(plane, 'g')} (misfit {misfit**0.5:.0f})"
    )
    misfit = quality["chi2_per_dof"]
    cells.append(f"{off(run, t)}; {off(run, s)}; {off(run, 'g')} (misfit {misfit**0.5:.1f})")
    return f"| {' | '.join(cells)} |"


def say(line: str) -> None:
    """Write a line at once."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def main() -> None:
    """Print the table."""
    names = sys.argv[1] if len(sys.argv) > 1 else "ADBC"
    height_mm = float(sys.argv[2]) if len(sys.argv) > 2 else 5.0
    index = float(sys.argv[3]) if len(sys.argv) > 3 else 1.33
    say(f"Height {height_mm:g} mm, surface index {index:g}.\n")
    say("| medium (sigma_t, albedo, g) | the paper's way | plane, all bounces | layer |")
    say("| --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            say(row(name, analysed(name, height_mm, index, Path(folder))))


if __name__ == "__main__":
    main()
