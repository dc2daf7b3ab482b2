"""Draw the contact sheet of the scenes that come along: picture, effects and cost of each.

    python docs/examples/gallery.py docs/images/gallery.png

Multiple scattering is sampled by fewer paths than the scene files ask for: enough to be looked at.
It takes some minutes the first time, and seconds after that.
"""

import sys
from pathlib import Path

import labrig
from labrig.figures import png_bytes
from labrig.figures_scene import Card, contact_sheet
from labrig.scene.decide import situation_of
from labrig.scene.explain import exposed, lit_images
from labrig.simulating import simulate

PATHS = 20_000  # most of a scene's
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
    if name != "dilute-milk":
        few = scene.transport.model_copy(update={"n_paths": PATHS})
        scene = scene.model_copy(update={"transport": few})
    plan = labrig.load_plan(folder / "plans" / "six-shifts.yaml")
    rig_name = "webcam" if name == "noisy-webcam" else "simulated"
    rig = labrig.load_rig(folder / "rigs" / f"{rig_name}.yaml")
    found = simulate(scene, rig, plan)
    picture, about = found.seen.picture, situation_of(scene, rig, plan)
    some = {n: image for n, image in lit_images(plan, rig).items() if n != "white"}
    frames = exposed(picture, picture.parts, some, about)
    x, y, width, height = rig.geometry.region_px or (0, 0, rig.camera.cols, rig.camera.rows)
    frame = frames[min(frames, key=lambda n: float(n.rsplit("-", 1)[1]))]
    answer, seconds = picture.answer, found.seconds - found.seen.transport_s
    cost = f"{seconds:.2f} CPU s for two pictures"
    if answer is not None:
        cost += f"; orders 2 .. {answer.n_bounces} by {answer.method}, kept"
    return Card(
        name=name,
        picture=frame[y : y + height, x : x + width],
        used=[d.name for d in found.seen.decisions if d.used],
        left_out=[d.name for d in found.seen.decisions if not d.used],
        cost=cost,
    )


if __name__ == "__main__":
    configs = labrig.config_folder()
    sheet = contact_sheet([card(name, configs) for name in SCENES])
    Path(sys.argv[1]).write_bytes(png_bytes(sheet))
