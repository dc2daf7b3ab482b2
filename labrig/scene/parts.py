"""What stands between projector and counts: one record, which effects edit."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.simulation.lamp import Lamp
from drivers.simulation.sensor import Sensor
from labrig.models.rig import Rig
from labrig.models.scene import Scene

Array = NDArray[np.float64]
Step = Callable[[Array], Array]


@dataclass(frozen=True, slots=True, kw_only=True)
class Parts:
    """The parts of a simulated world; as it is made, each leaves the light as it is.

    Attributes
    ----------
    scene : medium, tank, and the beam as it is inside
    single, multiple : which light there is at all
    isotropic : whether scattered light forgets its direction
    transfer : levels of projector pixels, 0 .. 1, to their light
    black_level : light of a black pixel, share of a white one
    blur_px, defocus_px_per_mm : standard deviation of a projector pixel at the face, and its
        growth with depth
    divergence_mm : distance of the point, inside the medium, from which the beam spreads
    transmission : share of the light that enters
    face_index, wall_reflectance : refractive index that turns scattered light back at the lit
        face, and what every other wall gives back
    ambient_e_per_s : light that is not the projector's
    optics : what lens and view do to a picture of the sensor's size, in order
    lamp : the projector's lamp over time
    sensor : that of a simulated camera
    """

    scene: Scene
    rig: Rig
    sensor: Sensor | None
    single: bool = False
    multiple: bool = False
    isotropic: bool = True
    transfer: Step | None = None
    black_level: float = 0.0
    blur_px: float = 0.0
    defocus_px_per_mm: float = 0.0
    divergence_mm: float = math.inf
    transmission: float = 1.0
    face_index: float = 1.0
    wall_reflectance: float = 0.0
    ambient_e_per_s: float = 0.0
    optics: tuple[Step, ...] = ()
    lamp: Lamp = field(default_factory=Lamp)
