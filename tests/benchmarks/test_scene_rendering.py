"""What simulated light costs: `make bench`. In `make test` at toy size."""

import time

import labrig
from drivers.simulation.sensor import Noise
from drivers.simulation.world import World
from labrig.config import parse
from labrig.plan import expand
from labrig.scene.pipeline import see, solve
from labrig.simulating import simulate

FOLDER = labrig.config_folder()
PLAN = {
    "schema": "labrig-plan/1",
    "name": "24 shots",
    "exposures": {"bracket_s": [0.0333, 0.1333, 0.5333]},
    "sets": [
        {"id": "stripes", "pattern": {"kind": "stripes", "period_px": 12, "shifts": 6}},
        {"id": "white", "pattern": {"kind": "uniform"}},
        {"id": "black", "pattern": {"kind": "black"}},
    ],
}


def scene_of(name: str, toy: bool) -> labrig.Scene:
    scene = labrig.load_scene(FOLDER / "scenes" / f"{name}.yaml")
    if not toy:
        return scene
    few = scene.transport.model_copy(update={"n_paths": 1600, "cell_mm": 5.0})
    return scene.model_copy(update={"transport": few})


def test_a_session_of_24_shots_is_rendered(benchmark, tmp_path):
    """Light and noise of 24 shots of 1.2 MP, and the whole capture; the transport is known."""
    toy = benchmark.disabled
    rig = labrig.load_rig(FOLDER / "rigs" / "simulated.yaml")
    plan = parse(PLAN, labrig.Plan, source="plan")
    scene = scene_of("dilute-milk", toy)
    see(scene, rig, plan)  # the transport, if it was never computed
    wall_s = time.perf_counter()
    shots, images = (expanded := expand(plan, rig)).shots, expanded.images

    def render() -> float:
        began_s = time.process_time()
        parts = (picture := see(scene, rig, plan).picture).parts
        assert parts.sensor is not None
        noise = Noise(parts.sensor, 1)
        for shot in shots[:2] if toy else shots:
            world = World(light=picture.light, projector_black=parts.black_level)
            world.project(images[shot.pattern], at_s=0.0)
            noise.digitise(world.expose(0.0, shot.exposure_s), shot.exposure_s, shot.id)
        noise.close()
        return time.process_time() - began_s

    rendered_s = benchmark.pedantic(render, rounds=1)
    if toy:
        return
    wall_s = time.perf_counter() - wall_s
    begun_s, captured_wall_s = time.process_time(), time.perf_counter()
    with labrig.open_rig(rig, scene, plan) as opened:
        labrig.capture(plan, opened, tmp_path)
    captured_s = time.process_time() - begun_s
    captured_wall_s = time.perf_counter() - captured_wall_s
    print(  # noqa: T201
        f"\n24 shots: {rendered_s:.2f} CPU s rendered ({wall_s:.2f} s by the clock), "
        f"{captured_s:.2f} CPU s captured and kept ({captured_wall_s:.2f} s by the clock)"
    )
    assert rendered_s < 5.0  # CPU of all threads, which no other work lengthens much


def test_the_ideal_scene_costs_next_to_nothing(benchmark):
    """CPU of the lit pictures: single scattering alone against all of it, transport anew."""
    toy = benchmark.disabled
    rig = labrig.load_rig(FOLDER / "rigs" / "simulated.yaml")
    plan = parse(PLAN, labrig.Plan, source="plan")
    ideal, full = scene_of("ideal", toy), scene_of("dilute-milk", toy)
    simulate(ideal, rig, plan)

    def alone() -> float:
        return simulate(ideal, rig, plan).seconds

    ideal_s = benchmark.pedantic(alone, rounds=1)
    seen = see(full, rig, plan).picture
    begun_s = time.process_time()
    solve(seen.parts, (12,), anew=True)
    full_s = time.process_time() - begun_s + simulate(full, rig, plan).seconds
    if benchmark.enabled:
        print(  # noqa: T201
            f"\nideal {ideal_s:.3f} CPU s, full {full_s:.1f} CPU s: {full_s / ideal_s:.0f} times"
        )
        assert full_s > 50.0 * ideal_s
