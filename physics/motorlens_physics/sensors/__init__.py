"""The second catalogue: what a sensor may do to a quantity, one model a file, found because it is there."""
