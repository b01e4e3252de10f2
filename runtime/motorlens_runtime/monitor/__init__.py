"""The live page of a running sensor: what it keeps, what it shows, how it attaches to a runtime that is there already."""
