"""From the line to samples: sources of bytes, dialects that decode them, our own frames, and the feed that joins them."""
