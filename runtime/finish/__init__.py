"""Finish: what is done to a reconstruction's image."""
