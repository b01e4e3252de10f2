"""What may be missing: effects, sensor faults, and terms without a name, all of them competitors."""
