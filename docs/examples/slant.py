"""Solve a beam that enters straight and one aslant, and draw how light forgets its direction.

Run as ``python docs/examples/slant.py slant.png``; after Fig. 14 of the paper.
"""

import sys
from pathlib import Path

import labrig
from labrig.models.scene import BeamConfig
from labrig.reporting import drawing
from labrig.reporting.figures_orders import slant_figure

ANGLES_DEG = (0.0, 30.0)
BEAMS_MM = ((25.0, 50.0), (10.0, 35.0))  # aslant it starts higher, so that it stays inside


def main(out: Path) -> int:
    """Write the figure as PNG and PDF."""
    milk = labrig.load_scene(labrig.config_folder() / "scenes" / "dilute-milk.yaml")
    fields = []
    for angle_deg, (from_mm, to_mm) in zip(ANGLES_DEG, BEAMS_MM, strict=True):
        beam = BeamConfig(from_mm=from_mm, to_mm=to_mm, angle_deg=angle_deg)
        solved = labrig.solve(milk.model_copy(update={"beam": beam}), orders=6, light_field=True)
        fields.append(solved.field)
    drawing.save(slant_figure((fields[0], fields[1])), out.with_suffix(""))
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else "slant.png")))
