"""Sparsify: from a dense PSF to its spreadlet."""
