"""The one world that all simulated devices share."""
