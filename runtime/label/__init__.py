"""Label: what the PSF of each pixel depends on."""
