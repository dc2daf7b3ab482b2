"""The steps of an analysis, with what a session allows and what must be said of it."""
