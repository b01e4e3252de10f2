"""The tests a motor can be put through, one scenario a file, found because it is there."""
