"""The physics observer inside a sensor: its design, its programs, its place in the file and in the network's frame."""
