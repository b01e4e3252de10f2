"""How good a sensor is: scores against other methods and the bound, and what they look like."""
