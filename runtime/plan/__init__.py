"""Plan: which PSF variants a frame needs, in which layers, and what is drawn where."""
