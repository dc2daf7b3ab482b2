"""Which effects there are, in the order in which light meets them, and where each is defined."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

from labrig.errors import PlanError
from labrig.models import effects as models
from labrig.models.base import Model
from labrig.models.effects import Effects
from labrig.scene.effects.base import Effect


@dataclass(frozen=True, slots=True)
class Entry:
    """An effect: key of `Effects`, name in a scene file, module, class, and its parameters' model.

    ``parameters`` is None for an effect that has none.
    """

    key: str
    name: str
    module: str
    effect: str
    parameters: type[Model] | None

    def make(self, asked: object) -> Effect[Any]:
        """Load the effect; ``asked`` is a word or its parameters."""
        found = importlib.import_module(f"labrig.scene.effects.{self.module}")
        kind: type[Effect[Any]] = getattr(found, self.effect)
        if self.parameters is None or isinstance(asked, self.parameters):
            return kind(asked)
        return kind(self.parameters())


ENTRIES = (
    Entry("gamma", "projector-gamma", "projector", "Gamma", models.GammaConfig),
    Entry("leak", "black-leak", "projector", "Leak", models.LeakConfig),
    Entry("blur", "projector-blur", "projector", "Blur", models.BlurConfig),
    Entry("defocus", "defocus", "projector", "Defocus", models.DefocusConfig),
    Entry("lamp_drift", "lamp-drift", "lamp", "LampDrift", models.LampDriftConfig),
    Entry("colour_wheel", "colour-wheel", "lamp", "ColourWheel", models.ColourWheelConfig),
    Entry("lamp_shape", "lamp-shape", "lamp", "LampShape", models.LampShapeConfig),
    Entry("refraction", "refraction", "face", "Refraction", models.RefractionConfig),
    Entry("fresnel", "fresnel", "face", "Fresnel", models.FresnelConfig),
    Entry("divergence", "divergence", "face", "Divergence", models.DivergenceConfig),
    Entry("single", "single-scattering", "scattering", "Single", None),
    Entry("multiple", "multiple-scattering", "scattering", "Multiple", None),
    Entry("anisotropy", "anisotropy", "scattering", "Anisotropy", None),
    Entry(
        "internal_reflection",
        "internal-reflection",
        "walls",
        "InternalReflection",
        models.InternalReflectionConfig,
    ),
    Entry("walls", "walls", "walls", "Walls", models.WallsConfig),
    Entry("ambient", "ambient", "lens", "Ambient", models.AmbientConfig),
    Entry("lens_blur", "lens-blur", "lens", "LensBlur", models.LensBlurConfig),
    Entry("oblique", "oblique-view", "view", "Oblique", models.ObliqueConfig),
    Entry("distortion", "distortion", "view", "Distortion", models.DistortionConfig),
    Entry("vignetting", "vignetting", "lens", "Vignetting", models.VignettingConfig),
    Entry(
        "rolling_shutter",
        "rolling-shutter",
        "sensor",
        "RollingShutter",
        models.RollingShutterConfig,
    ),
    Entry("hot_pixels", "hot-pixels", "sensor", "HotPixels", models.HotPixelsConfig),
    Entry("shot_noise", "shot-noise", "sensor", "ShotNoise", None),
    Entry("read_noise", "read-noise", "sensor", "ReadNoise", None),
    Entry("blooming", "blooming", "sensor", "Blooming", models.BloomingConfig),
    Entry("response", "response", "sensor", "Response", models.ResponseConfig),
    Entry("saturation", "saturation", "sensor", "Saturation", None),
    Entry("quantisation", "quantisation", "sensor", "Quantisation", None),
)


def named(effects: Effects) -> list[tuple[Entry, object]]:
    """Return the effects that a scene names, each with what it says of it, in the light's order."""
    asked = [(entry, getattr(effects, entry.key)) for entry in ENTRIES]
    return [(entry, said) for entry, said in asked if said is not None]


def refuse_unknown(names: tuple[str, ...], effects: Effects) -> None:
    """Refuse to force what the scene does not name.

    Raises
    ------
    PlanError
        Naming what it does name.
    """
    known = [entry.name for entry, _ in named(effects)]
    for name in names:
        if name not in known:
            msg = f"effect {name!r} is not among those of the scene: {', '.join(known)}."
            raise PlanError(msg)
