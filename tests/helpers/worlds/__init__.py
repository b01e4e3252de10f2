"""Worlds in which a sensor of the paper's motor is judged: another plant, drives, sensors and motors than it was trained on.

Nothing here shares code with the packages. `plant` integrates the motor, `world` draws what is done to it and what is
measured of it, `judge` holds a sensor's answers against the truth.
"""
