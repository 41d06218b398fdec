"""Offline: PSF model -> cells -> light-traced PSF -> spreadlet -> database."""
