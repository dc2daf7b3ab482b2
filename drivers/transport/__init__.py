"""Bytes to and from devices; what they mean is known one floor above."""
