"""The drive on the other end of the wire: plant, analogue-digital converter, framing and faults."""
