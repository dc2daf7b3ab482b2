"""Configuration files, read."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from labrig.config import load
from labrig.folders import config_folder
from labrig.models.analysis import Analysis
from labrig.models.plan import Plan
from labrig.models.rig import Rig
from labrig.models.scene import Scene
from labrig.models.series import Concentrations

__all__ = ["Analysis", "Plan", "Rig", "Scene", "StrPath", "config_folder"]
__all__ += ["load_analysis", "load_plan", "load_rig", "load_scene", "load_series"]

StrPath = str | PathLike[str]


def load_plan(path: StrPath) -> Plan:
    """Read a capture plan; raise `labrig.errors.ConfigError` naming file and key."""
    return load(Path(path), Plan)


def load_rig(path: StrPath) -> Rig:
    """Read a rig file; raise `labrig.errors.ConfigError` naming file and key."""
    return load(Path(path), Rig)


def load_scene(path: StrPath) -> Scene:
    """Read a scene file; raise `labrig.errors.ConfigError` naming file and key."""
    return load(Path(path), Scene)


def load_series(path: StrPath) -> Concentrations:
    """Read the concentrations of a series; raise `labrig.errors.ConfigError` if it is none."""
    return load(Path(path), Concentrations)


def load_analysis(path: StrPath) -> Analysis:
    """Read an analysis file; raise `labrig.errors.ConfigError` naming file and key.

    Records it names are found relative to the file.
    """
    found = load(Path(path), Analysis)
    beside = Path(path).resolve().parent
    named = {kind: str(beside / record) for kind, record in found.calibration.items()}
    return found.model_copy(update={"calibration": named})
