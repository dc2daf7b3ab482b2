"""Speaks to hardware, real or simulated."""
