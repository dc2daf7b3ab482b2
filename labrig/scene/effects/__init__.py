"""Effects of light, lens and camera: a scene names them, and only those named are loaded."""
