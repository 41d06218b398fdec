"""Helpers of kernels that keep lamps out of what is guessed."""

import math

from spreadlets.compiled import helper

BRIGHTEST = 4.0
"""How many times as bright as the mean around it what is guessed may be: a lamp that is not there would catch the eye,
and in a sequence it would flash."""


@helper
def evened(light):
    """Return the fourth root of light: to a mean of such, a lamp hardly adds."""
    return math.sqrt(math.sqrt(light))


@helper
def dimmed(light, limit):
    """Return as how bright that is guessed which is brighter than a limit, `BRIGHTEST` times the mean around.

    The brighter it is, the more of it is a lamp's: what is twice the limit counts half of that, but no less than the
    mean.
    """
    return light if light <= limit else max(limit * limit / light, limit / BRIGHTEST)
