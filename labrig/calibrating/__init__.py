"""Calibration records: made of sessions, kept beside them, shown on a page."""
