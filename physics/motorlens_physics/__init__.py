"""The motor and its effects, parameter files, recordings with units, simulation and calibration."""
