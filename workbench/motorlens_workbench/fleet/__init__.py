"""Many motors of one make: every recording fitted once, by a queue of tasks, and a population made of what was found."""
