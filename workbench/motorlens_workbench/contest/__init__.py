"""Which hypotheses belong into a model, and what could stand in the place of each."""
