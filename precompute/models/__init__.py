"""The PSF models: how each draws rays for the light tracer."""
