"""Bounces of a scene, solved to a tolerance."""

from labrig.solving import Cost, Solved, explain, write_solution
from labrig.solving import solve_scene as solve

__all__ = ["Cost", "Solved", "explain", "solve", "write_solution"]
