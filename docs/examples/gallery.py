"""Draw the contact sheet of the scenes that come along: picture, effects and cost of each.

    python docs/examples/gallery.py docs/images/gallery.png

It takes some minutes the first time, for the multiple scattering, and seconds after that.
"""

import sys
from pathlib import Path

import labrig
from labrig.reporting.drawing import png_bytes
from labrig.reporting.figures_scene import Card, contact_sheet
from labrig.scene.decide import Decision, situation_of
from labrig.scene.explain import exposed, lit_images
from labrig.simulating import simulate

SCENES = (
    "ideal",
    "dilute-milk",
    "thick-milk",
    "forward-peaked",
    "slanted-beam",
    "refracting-face",
    "noisy-webcam",
)


def card(name: str, folder: Path) -> Card:
    """Simulate one scene; what is shown is what its camera reads under stripes."""
    scene = labrig.load_scene(folder / "scenes" / f"{name}.yaml")
    plan = labrig.load_plan(folder / "plans" / "six-shifts.yaml")
    rig_name = "webcam" if name == "noisy-webcam" else "simulated"
    rig = labrig.load_rig(folder / "rigs" / f"{rig_name}.yaml")
    found = simulate(scene, rig, plan)
    picture, about = found.seen.picture, situation_of(scene, rig, plan)
    some = {n: image for n, image in lit_images(plan, rig).items() if n != "white"}
    frames = exposed(picture, some, about)
    x, y, width, height = rig.geometry.region_px or (0, 0, rig.camera.cols, rig.camera.rows)
    frame = frames[min(frames, key=lambda n: float(n.rsplit("-", 1)[1]))]
    seconds, answer = found.seconds - found.seen.transport_s, picture.answer
    cost = f"{seconds:.2g} CPU s for two pictures"
    if answer is not None:
        cost += f"; {answer.seconds:.0f} CPU s, once, for bounces 2 .. {answer.n_bounces}"
        cost += f" by {answer.method}"
    decisions = found.seen.decisions
    left_out = [f"{d.name} (at most {100.0 * d.bound:.2g} %)" for d in decisions if _spared(d)]
    idle = [d.name for d in decisions if not d.used and d.bound == 0.0]
    foot = [f"left out: {', '.join(left_out)}"] if left_out else []
    foot += [f"nothing to do for: {', '.join(idle)}"] if idle else []
    return Card(
        name=name,
        picture=frame[y : y + height, x : x + width],
        mm_per_px=rig.geometry.mm_per_px or 1.0,
        used=[d.name for d in decisions if d.used],
        foot=[*foot, cost],
    )


def _spared(decision: Decision) -> bool:
    """Tell whether an effect is left out that would change something."""
    return not decision.used and decision.bound > 0.0


if __name__ == "__main__":
    configs = labrig.config_folder()
    sheet = contact_sheet([card(name, configs) for name in SCENES])
    Path(sys.argv[1]).write_bytes(png_bytes(sheet))
