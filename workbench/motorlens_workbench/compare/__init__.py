"""What `motorlens compare` computes: a motor file beside recordings, how far it is off, and where."""
