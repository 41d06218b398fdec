"""Splat: the points of each pixel's PSF, drawn into Laplacian and direct images."""
