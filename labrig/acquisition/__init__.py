"""A plan run on an open rig: what is checked before, how a shot is taken, what a run may do."""
