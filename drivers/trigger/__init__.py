"""Triggers: what makes a camera expose."""
