"""Worlds in which a sensor is judged: another plant, drives, sensors and motors than it was made for.

The plant shares no code with `physics`: what is wrong there is not wrong here alike. `plant` integrates the motor, `drive`
says what motor a file describes and what it is measured with, `world` draws what is done to it, `judge` holds a sensor's
answers against the truth, and `table` sums up many worlds by factor.
"""
