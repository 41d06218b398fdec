"""Naive twins of the fast paths: slow, plain, and independent of the package."""
