"""Counts turned into something a physicist trusts."""
