"""Integrate: from a Laplacian image to the image."""
