"""What accuracy costs in time: of the solver, of the capture, of the simulated scene."""
