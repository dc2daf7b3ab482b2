"""Emulated devices, each as near to the wire as this machine allows."""
