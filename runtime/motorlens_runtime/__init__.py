"""The virtual sensor on the drive PC: sources, framing, gate, estimator, publishers and the command line."""
