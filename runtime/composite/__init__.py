"""Composite: layers normalised, filled where they were hidden, and put behind each other."""
