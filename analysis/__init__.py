"""What the pictures say about the medium: the paper's equations, as pure functions."""
