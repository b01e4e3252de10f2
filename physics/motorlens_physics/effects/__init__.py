"""The catalogue: everything the textbook motor leaves out, one effect a file, found because it is there."""
